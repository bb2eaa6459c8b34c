# SPDX-License-Identifier: Apache-2.0
"""An arm and its controller, connected by calls, and what came of a cause."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from benchmark.false_states import PERIOD, Falsifier, Reading
from benchmark.nodes import PERIOD_NS, taught
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.safety import REST_SPEED
from wam_power_ros.faults import Fault, FaultKind

STALE_PERIODS = 3  # [periods] of silence until the controller uses its model
LOST_PERIODS = 10  # [periods] of silence until it is a fault
SPEED_MARGIN = 0.5  # [m/s] allowed increase of the tool's peak speed by false states
REST_TICKS = 250  # [periods] from the fault to rest: 0.5 s
TRAVEL_MAX = 0.05  # [m] largest travel of the tool after a fault
AFTER = 10.0  # [s] of observation
MOMENTS = {"early": 0.10, "upwards": 0.25, "late": 0.40}  # as shares of the rollout's movement
PHASES = (*MOMENTS, "move", "hold", "teaching")
A_FAULT = Fault(FaultKind.OVERLOAD, "a fault that has nothing to do with the states")


class Plant(Protocol):
    """An arm that keeps the last torque."""

    def step(self, tau: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Let a torque act for a period; returns reported q and qd."""

    def tool_position(self) -> np.ndarray:
        """Position of the tool [m]. Shape (3,)."""

    def tool_speed(self) -> float:
        """Speed of the tool [m/s]."""

    def let_go(self) -> None:
        """Whoever guides or pushes the tool lets it go."""


class Outcome(NamedTuple):
    """What came of a cause; all speeds [m/s] and distances [m] are of the tool, and the largest."""

    fault: FaultKind | None  # None without one
    noticed: int | None  # periods until the fault
    peak: float  # speed
    rest: float  # speed from 0.5 s after the fault on, or in all without one
    travel: float  # distance from where it was 0.5 s after the fault, or at the beginning
    stop: float  # distance from where it was at the fault
    reset: bool = True  # a fault could be reset after the observation, or there was none
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


def acceptable(found: Outcome, nominal: float) -> bool:
    """Whether the arm was stopped, and stays where it was stopped."""
    return stopped(found, nominal) and found.travel < TRAVEL_MAX


class Loop:
    """The arm and its controller, connected by calls.

    Attributes:
        falsify: Changes a state before the controller receives it; returns None for silence.
        speeds, path: Speeds [m/s] and positions [m] of the tool, at the beginning of the last
            `play` and after each period.
    """

    def __init__(self, plant: Plant, controller: Controller) -> None:
        self.plant, self.controller = plant, controller
        self.policy = taught()
        controller.load(self.policy)
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
