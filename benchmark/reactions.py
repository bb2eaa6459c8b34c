# SPDX-License-Identifier: Apache-2.0
"""What an arm does that is not the model: after a fault of true states, and with hands off.

    python -m benchmark.reactions [--cases faults hands_off] [--delay 2] [--arms 12]

Controller and arm are in one process; the arm keeps the last torque. For each case and phase the
largest speed of the tool is printed, also that from 0.5 s after the fault on, and how far the tool
travels in the 10 s after the fault.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmark.false_states import REST_TICKS, SPEED_MARGIN
from benchmark.hidden_arm import KNOWN, draw
from benchmark.moments import PERIOD, Loop
from hardware_sim.hidden_arm import HiddenArm
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.safety import REST_SPEED
from wam_power_ros.faults import Fault, FaultKind

TRAVEL_MAX = 0.05  # [m] largest travel of the tool after a fault
HANDS_OFF_SPEED = 0.3  # [m/s] largest speed of an arm that leaves by itself until it is stopped
AFTER = 10.0  # [s] of observation
MOMENTS = {"early": 0.10, "upwards": 0.25, "late": 0.40}  # as shares of the rollout's movement
PHASES = (*MOMENTS, "move", "hold", "teaching")
A_FAULT = Fault(FaultKind.OVERLOAD, "a fault that has nothing to do with the states")


class Outcome(NamedTuple):
    """Reaction of the arm.

    Attributes:
        fault: Kind of the fault; None without one.
        noticed: Periods until the fault; None without one.
        peak: Largest speed of the tool [m/s].
        rest: Largest speed of the tool from 0.5 s after the fault on [m/s].
        travel: Largest distance of the tool from where it was 0.5 s after the fault, or from its
            beginning without a fault [m].
        stop: The same distance from where the tool was at the fault [m].
        reset: Whether the fault could be reset after the observation.
    """

    fault: FaultKind | None
    noticed: int | None
    peak: float
    rest: float
    travel: float
    stop: float
    reset: bool


def begin(loop: Loop, phase: str) -> str:
    """Bring the arm to a phase; returns why it was not reached, empty if it was."""
    try:
        _begin(loop, phase)
    except ControllerError as error:
        return str(error)
    return "" if loop.controller.latched is None else loop.controller.latched.text


def _begin(loop: Loop, phase: str) -> None:
    core = loop.controller
    loop.play(0.5)
    if phase in MOMENTS:
        core.move_to_start()
        for _ in range(2000):
            loop.play(PERIOD)
            if core.ready:
                break
        core.execute()
        loop.play(MOMENTS[phase] * loop.policy.basis.duration)
    elif phase in ("move", "teaching"):
        core.set_gravity_compensation(True)
        loop.guide(0)
        loop.play(0.4)
    if phase == "move":
        loop.guide(None)
        core.set_gravity_compensation(False)
        loop.play(1.0)
        core.move_to_start()
        loop.play(0.3)


def observe(loop: Loop, seconds: float = AFTER) -> Outcome:
    """Watch the arm for some time [s]; the person lets go at a fault."""
    core, noticed = loop.controller, list[int]()
    path = []

    def watch() -> None:
        path.append(loop.tool())
        if not noticed and core.mode is Mode.FAULT:
            noticed.append(len(loop.speeds))
            loop.guide(None)

    speeds = loop.play(seconds, watch)
    begun = noticed[0] if noticed else 0
    calm = begun + (REST_TICKS if noticed else 0)
    way = np.array(path)
    travel, stop = (
        float(np.linalg.norm(way[at:] - way[at], axis=1).max()) if at < len(way) else 0.0
        for at in (calm, begun)
    )
    kind = core.latched.kind if core.latched else None
    reset = True
    try:
        if noticed:
            core.reset()
    except ControllerError:
        reset = False
    at = noticed[0] if noticed else None
    return Outcome(kind, at, max(speeds), max(speeds[calm:], default=0.0), travel, stop, reset)


def row(name: str, phase: str, nominal: float, outcome: Outcome, good: bool) -> str:
    """Line of the table."""
    kind = "none" if outcome.fault is None else outcome.fault.value
    after = "" if outcome.noticed is None else f" after {2 * outcome.noticed} ms"
    speeds = f"{outcome.peak:.2f} ({nominal:.2f}) | {outcome.rest:.3f}"
    ways = f"{100 * outcome.travel:.1f} | {100 * outcome.stop:.1f}"
    answers = f"{'yes' if outcome.reset else 'no'} | {'good' if good else '**bad**'}"
    return f"| {name} | {phase} | {kind}{after} | {speeds} | {ways} | {answers} |"


def acceptable(outcome: Outcome, nominal: float) -> bool:
    """Whether the arm was stopped, and stays where it was stopped."""
    stopped = outcome.fault is None or outcome.rest < REST_SPEED
    return outcome.peak <= nominal + SPEED_MARGIN and stopped and outcome.travel < TRAVEL_MAX


def nominal_peak(phase: str, delay: int, hidden: HiddenArm | None = None) -> float | str:
    """Largest speed of the tool in a phase without any fault [m/s]; or why it was not reached."""
    loop = Loop(delay, hidden)
    return begin(loop, phase) or max(loop.play(1.2))


def all_arms(arms: int) -> Iterator[tuple[str, HiddenArm]]:
    """The known arms, then drawn ones."""
    yield from KNOWN.items()
    for seed in range(9000, 9000 + arms):
        yield f"drawn arm {seed}", draw(seed)


def faults(delay: int, arms: int) -> Iterator[tuple[str, bool]]:
    """A fault of an arm that is not the model."""
    for name, hidden in all_arms(arms):
        for phase in PHASES:
            nominal = nominal_peak(phase, delay, hidden)
            if isinstance(nominal, str):
                yield f"| {name} | {phase} | not reached: {nominal} | | | | | | good |", True
                continue
            loop = Loop(delay, hidden)
            begin(loop, phase)
            loop.controller.fault(A_FAULT)
            outcome = observe(loop)
            good = acceptable(outcome, nominal) and outcome.reset
            yield row(name, phase, nominal, outcome, good), good


def hands_off(delay: int, arms: int) -> Iterator[tuple[str, bool]]:
    """Gravity compensation of an arm that is not the model and that nobody touches."""
    for name, hidden in all_arms(arms):
        loop = Loop(delay, hidden)
        loop.play(1.0)
        try:
            loop.controller.set_gravity_compensation(True)
        except ControllerError as error:
            yield f"| {name} | hands off | {error} | | | | | | good |", True
            continue
        outcome = observe(loop)
        good = outcome.travel < TRAVEL_MAX or (
            outcome.fault is not None and outcome.peak < HANDS_OFF_SPEED
        )
        yield row(name, "hands off", 0.0, outcome, good), good


CASES = {"faults": faults, "hands_off": hands_off}


def main(arguments: list[str] | None = None) -> int:
    """Print a row for each case and phase; return 1 if the arm was not stopped."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--delay", type=int, default=2, help="periods until a torque acts")
    parser.add_argument("--arms", type=int, default=12, help="number of drawn arms")
    given = parser.parse_args(arguments)
    speeds = "peak (nominal) [m/s] | after 0.5 s"
    print(f"| case | phase | fault | {speeds} | travel [cm] | with the stop | reset | |")
    print("|---|---|---|---|---|---|---|---|---|")
    bad = 0
    for name in given.cases:
        for line, good in CASES[name](given.delay, given.arms):
            bad += not good
            print(line, flush=True)
    print(f"{bad} bad")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
