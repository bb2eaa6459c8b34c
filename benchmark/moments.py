# SPDX-License-Identifier: Apache-2.0
"""False joint states that begin at random moments, and end: controller and arm in one process.

    python -m benchmark.moments [--repeats 12] [--lies frozen ...] [--delay 2]

The false states of `benchmark.false_states` are passed to a controller that is connected by calls
to the simulated arm, which keeps the last torque. They begin at a random moment of a rollout, a
move or a demonstration. The arm is observed until 0.5 s after the fault and for 2 s more. Then true
states return: they must not move the arm, and the fault must be resettable.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmark.false_states import (
    FALSE_STATES,
    REST_TICKS,
    SPEED_MARGIN,
    WATCH_TICKS,
    Falsifier,
    Reading,
    frozen,
    stamps,
)
from benchmark.hidden_arm import NOMINAL, world
from benchmark.nodes import JOINTS
from benchmark.soak import taught
from hardware_sim.demonstrator import Demonstrator
from hardware_sim.hidden_arm import HiddenArm
from hardware_sim.scenes.flip import wrist_flick
from hardware_sim.wam import PERIOD_NS
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.safety import REST_SPEED, limits_of
from wam_power_ros.faults import Fault, FaultKind

PERIOD = PERIOD_NS * 1e-9
STALE_PERIODS = 3  # [periods] of silence until the controller uses its model
LOST_PERIODS = 10  # [periods] of silence until it is a fault
ALL_FALSE_STATES = FALSE_STATES | {
    "joint 6 frozen": lambda: frozen(5),
    "stamps at three times the speed": lambda: stamps(3.0),
    "stamps at half the speed": lambda: stamps(0.5),
}
PHASES = ("rollout", "move", "teaching")


def taught_fast(arm: Arm) -> Controller:
    """Controller of an arm that is guided at the speed of a toss."""
    return Controller(arm, ControllerSettings(limits=limits_of(arm, teaching_tool_speed=4.0)))


class Loop:
    """The arm and its controller, connected by calls.

    Attributes:
        falsify: Changes a state before the controller receives it; returns None for silence.
        speeds: Speed of the tool in every period [m/s].

    Args:
        delay: Periods until a torque acts.
        hidden: Deviations of the arm from its model.
        make: Makes the controller; None: one for a task that is taught fast.
    """

    def __init__(
        self,
        delay: int,
        hidden: HiddenArm | None = None,
        make: Callable[[Arm], Controller] | None = None,
    ) -> None:
        hidden = hidden or NOMINAL
        self._world, self._zeros = world(hidden, delay), hidden.zeros
        self._arm = Arm(self._world.urdf, JOINTS)
        self.controller = (make or taught_fast)(Arm(self._world.urdf, JOINTS))
        self.policy = taught()
        self.controller.load(self.policy)
        self._world.reset("moments", self.policy.q_start)
        self._world.release()
        self._tau: np.ndarray | None = None
        self._stamp_ns, self._last_ns, self._silent = 10**15, 0, 0
        self.falsify: Falsifier = lambda state: state
        self.speeds: list[float] = []
        self.play(0.05)
        self.controller.hold()
        self.play(0.3)

    def guide(self, seed: int | None) -> None:
        """Attach a demonstrator with this seed to the pan; None: detach it."""
        flick = None if seed is None else wrist_flick(np.random.default_rng(seed))
        self._world.attach(None if flick is None else Demonstrator(flick, *self._world.tool_pose))

    def play(self, seconds: float, watch: Callable[[], None] = lambda: None) -> list[float]:
        """Run the arm for a time [s]; return the speeds of the tool [m/s]."""
        self.speeds = []
        for _ in range(round(seconds / PERIOD)):
            watch()
            self._world.step(self._tau)
            sample = self._world.joint_state()
            self.speeds.append(self._arm.speeds(sample.q - self._zeros, sample.qd).tool_speed)
            self._stamp_ns += PERIOD_NS
            state = Reading(self._stamp_ns, sample.q, sample.qd)
            self._answer(self.falsify(state))
        return self.speeds

    def tool(self) -> np.ndarray:
        """Position of the tool [m]. Shape (3,)."""
        return self._world.tool_pose[0]

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

    def begin(self, phase: str, rng: np.random.Generator) -> None:
        """Bring the arm to a random moment of a phase."""
        core = self.controller
        if phase == "rollout":
            core.execute()
            self.play(rng.uniform(0.02, 0.95 * self.policy.basis.duration))
            return
        core.set_gravity_compensation(True)
        self.guide(int(rng.integers(100)))
        self.play(rng.uniform(0.2, 1.2))
        if phase == "move":
            self.guide(None)
            core.set_gravity_compensation(False)
            self.play(1.0)
            core.move_to_start()
            self.play(rng.uniform(0.05, 0.4))


class Outcome(NamedTuple):
    """Reaction to false states.

    Attributes:
        noticed: Periods until the fault; None without a fault.
        peak: Largest speed of the tool in the first 1.2 s [m/s].
        rest: Largest speed of the tool from 0.5 s after the fault on, in those and 2 s more [m/s].
        after: Largest speed of the tool after true states have returned [m/s].
        reset: True if the fault could be reset then.
    """

    noticed: int | None
    peak: float
    rest: float
    after: float
    reset: bool


def inject(name: str, phase: str, rng: np.random.Generator, delay: int) -> Outcome:
    """Let false states begin at a random moment of a phase, and end."""
    loop = Loop(delay)
    core = loop.controller
    loop.begin(phase, rng)
    loop.falsify = ALL_FALSE_STATES[name]()
    noticed: list[int] = []

    def watch() -> None:
        if not noticed and core.mode is Mode.FAULT:
            noticed.append(len(loop.speeds))
            loop.guide(None)

    speeds = loop.play(WATCH_TICKS * PERIOD, watch)
    later = loop.play(2.0) if noticed else []
    calm = [*speeds[noticed[0] + REST_TICKS :], *later] if noticed else []
    loop.guide(None)
    loop.falsify = lambda state: state
    after = loop.play(3.0)
    try:
        if core.mode is Mode.FAULT:
            core.reset()
    except ControllerError:
        pass
    peak, rest = max(speeds), max(calm, default=0.0)
    at = noticed[0] if noticed else None
    return Outcome(at, peak, rest, max(after), core.mode is not Mode.FAULT)


def main(arguments: list[str] | None = None) -> int:
    """Print a row for each kind of false state and phase; return 1 if the arm was not stopped."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=12)
    parser.add_argument(
        "--lies",
        nargs="+",
        choices=list(ALL_FALSE_STATES),
        default=list(ALL_FALSE_STATES),
        help="kinds of false states (default: all)",
    )
    parser.add_argument("--delay", type=int, default=2, help="periods until a torque acts")
    given = parser.parse_args(arguments)
    loop = Loop(given.delay)
    loop.controller.execute()
    most = max(loop.play(1.2)) + SPEED_MARGIN
    print("| false state | phase | faults | within [ms] | peak [m/s] | rest | after | reset | |")
    print("|---|---|---|---|---|---|---|---|---|")
    failed = 0
    for name in given.lies:
        for phase in PHASES:
            seeds = range(7000, 7000 + given.repeats)
            found = [inject(name, phase, np.random.default_rng(k), given.delay) for k in seeds]
            late = [each.noticed for each in found if each.noticed is not None]
            guided = phase == "teaching"  # as fast as the demonstrator guides it
            good = [
                (guided or e.peak <= most) and e.rest < REST_SPEED and e.after < SPEED_MARGIN
                for e in found
            ]
            failed += len(found) - sum(good)
            print(
                f"| {name} | {phase} | {len(late)} of {len(found)} | {2 * max(late, default=0)} "
                f"| {max(e.peak for e in found):.2f} | {max(e.rest for e in found):.3f} "
                f"| {max(e.after for e in found):.2f} | {sum(e.reset for e in found)} "
                f"| {sum(good)} good |",
                flush=True,
            )
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
