# SPDX-License-Identifier: Apache-2.0
"""An arm and its controller, connected by calls, and what came of a cause."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmark.false_states import PERIOD, Falsifier, Reading
from benchmark.nodes import JOINTS, PERIOD_NS, taught
from benchmark.plant import HOME, NOMINAL, Plant
from hardware_sim.hidden_arm import HiddenArm
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.safety import REST_SPEED, limits_of
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.params.resources import share

STALE_PERIODS = 3  # [periods] of silence until the controller uses its model
LOST_PERIODS = 10  # [periods] of silence until it is a fault
SPEED_MARGIN = 0.5  # [m/s] allowed increase of the tool's peak speed by false states
REST_TICKS = 250  # [periods] from the fault to rest: 0.5 s
AFTER = 10.0  # [s] of observation
MOMENTS = {"early": 0.10, "upwards": 0.25, "late": 0.40}  # as shares of the rollout's movement
PHASES = (*MOMENTS, "move", "hold", "teaching")
A_FAULT = Fault(FaultKind.OVERLOAD, "a fault that has nothing to do with the states")


class Outcome(NamedTuple):
    """What came of a cause; all speeds [m/s] and distances [m] are of the tool, and the largest."""

    fault: FaultKind | None  # None without one
    noticed: int | None  # periods until the fault
    peak: float  # speed
    rest: float  # speed from 0.5 s after the fault on, or in all without one
    travel: float  # distance from where it was 0.5 s after the fault, or at the beginning
    stop: float  # distance from where it was at the fault
    reset: bool = True  # a fault could be reset after the observation, or there was none
    after: float = 0.0  # speed after true states have returned
    nominal: float = 0.0  # speed without the cause
    before: float = 0.0  # distance from the nominal path until the fault
    way: float = 0.0  # way after the fault beyond that of a stop from true states
    unreached: str = ""  # why the cause did not come


def outcome(
    fault: FaultKind | None, noticed: int | None, speeds: list[float], path: list[np.ndarray]
) -> Outcome:
    """What came of a cause, by speeds (k,) and positions (k, 3) of the tool after each period."""
    begun = noticed or 0
    calm = begun + (0 if noticed is None else REST_TICKS)
    way = np.array(path)
    travel, stop = (
        float(np.linalg.norm(way[at:] - way[at], axis=1).max()) if at < len(way) else 0.0
        for at in (calm, begun)
    )
    return Outcome(fault, noticed, max(speeds), max(speeds[calm:], default=0.0), travel, stop)


def stopped(found: Outcome, nominal: float) -> bool:
    """Whether the tool stayed slow, in m/s, and came to rest after a fault."""
    rested = found.noticed is None or found.rest < REST_SPEED
    return found.peak <= nominal + SPEED_MARGIN and rested


def controller_of(arm: Arm, **limits: float) -> Controller:
    """Controller with the default settings, but for some limits."""
    return Controller(arm, ControllerSettings(limits=limits_of(arm, **limits)))


class Loop:
    """The arm and its controller, connected by calls.

    Attributes:
        falsify: Changes a state before the controller receives it; returns None for silence.
        speeds, path: Speeds [m/s] and positions [m] of the tool, at the beginning of the last
            `play` and after each period.
    """

    def __init__(
        self,
        hidden: HiddenArm,
        make: Callable[[Arm], Controller] = controller_of,
        q: np.ndarray = HOME,
    ) -> None:
        self.plant, self.policy = Plant(hidden, q), taught()
        self.controller = make(Arm(share("urdf/wam7.urdf").read_text(), JOINTS))
        self.controller.load(self.policy)
        self.falsify: Falsifier = lambda state: state
        self.speeds: list[float] = []
        self.path: list[np.ndarray] = []
        self._tau: np.ndarray | None = None
        self._stamp_ns, self._last_ns, self._silent = 10**15, 0, 0

    def hold(self, seconds: float) -> None:
        """Hold the arm where it is, for some time [s]."""
        self.play(0.05)
        self.controller.hold()
        self.play(seconds)

    def play(self, seconds: float, watch: Callable[[], bool | None] = lambda: None) -> None:
        """Run for some time [s]; ends early when `watch` returns True."""
        plant = self.plant
        self.speeds, self.path = [plant.tool_speed()], [plant.tool_position()]
        for _ in range(round(seconds / PERIOD)):
            if watch():
                return
            q, qd = plant.step(self._tau)
            self.speeds.append(plant.tool_speed())
            self.path.append(plant.tool_position())
            self._stamp_ns += PERIOD_NS
            self._answer(self.falsify(Reading(self._stamp_ns, q, qd)))

    def _answer(self, state: Reading | None) -> None:
        core = self.controller
        if state is not None and state.stamp_ns != self._last_ns:
            self._silent, self._last_ns = 0, state.stamp_ns
            self._tau = core.step(*state, PERIOD)
            return
        self._silent += 1
        if self._silent > LOST_PERIODS:
            core.fault(Fault(FaultKind.STATES_LOST, "silence"))
        if self._silent >= STALE_PERIODS:
            first = self._silent == STALE_PERIODS
            self._tau = core.stale_torque(PERIOD * (STALE_PERIODS if first else 1))

    def observe(
        self, seconds: float = AFTER, enough: Callable[[int | None], bool] = lambda at: False
    ) -> Outcome:
        """Run for some time [s]; a fault lets the person let go.

        `enough` ends it early; it gets the periods until the fault, None before it.
        """
        core, noticed = self.controller, list[int]()

        def watch() -> bool:
            if not noticed and core.mode is Mode.FAULT:
                noticed.append(len(self.speeds) - 1)
                self.plant.let_go()
            return enough(noticed[0] if noticed else None)

        self.play(seconds, watch)
        kind = core.latched.kind if core.latched else None
        return outcome(kind, noticed[0] if noticed else None, self.speeds[1:], self.path[:-1])

    def reset(self) -> bool:
        """Reset the fault, if any; whether that was possible."""
        try:
            if self.controller.mode is Mode.FAULT:
                self.controller.reset()
        except ControllerError:
            return False
        return True


FAST = partial(controller_of, teaching_tool_speed=4.0)  # an arm may be guided as fast as a toss


def held(hidden: HiddenArm = NOMINAL, make: Callable[[Arm], Controller] = FAST) -> Loop:
    """An arm that is held at the start of the policy."""
    loop = Loop(hidden, make, taught().q_start)
    loop.hold(0.3)
    return loop


def begin(loop: Loop, phase: str, rng: np.random.Generator | None = None) -> None:
    """Bring a held arm to a moment of a phase: of `PHASES`, or with a generator to a drawn one.

    Raises:
        ControllerError: A fault has ended it before.
    """
    core, plant = loop.controller, loop.plant

    def drawn(low: float, high: float, usual: float) -> float:
        return usual if rng is None else float(rng.uniform(low, high))

    loop.play(0.5)
    if phase in MOMENTS:
        core.move_to_start()
        while not core.ready and core.latched is None:
            loop.play(PERIOD)
        core.execute()
        loop.play(drawn(0.02, 0.95, MOMENTS[phase]) * loop.policy.basis.duration)
    elif phase in ("move", "teaching"):
        core.set_gravity_compensation(True)
        plant.guide(0 if rng is None else int(rng.integers(100)))
        loop.play(drawn(0.2, 1.2, 0.4))
    if phase == "move":
        plant.let_go()
        core.set_gravity_compensation(False)
        loop.play(1.0)
        core.move_to_start()
        loop.play(drawn(0.05, 0.4, 0.3))
