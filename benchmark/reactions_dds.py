# SPDX-License-Identifier: Apache-2.0
"""Reactions over DDS in real time, with the controller as a process.

    python -m benchmark.reactions_dds [--cases cells faults hands_off] [--arms 12]

A dozen cells of `benchmark.reaction_matrix`, and the cases of `benchmark.reactions`.

The arm is simulated in this process and keeps the last torque, which tells the mode.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmark.false_states import REST_TICKS, Driver, Falsifier, Reading
from benchmark.lab import ARM, Lab
from benchmark.reaction_matrix import LIES
from benchmark.reactions import (
    AFTER,
    HANDS_OFF_SPEED,
    TRAVEL_MAX,
    Outcome,
    acceptable,
    all_arms,
    row,
)
from hardware_sim.hidden_arm import HiddenArm
from wam_power_ros.faults import FaultKind
from wam_power_ros.ros import interface, scheduling

MARGIN = 0.2  # [m/s] above the nominal speed: 0.1, and what a busy machine adds
CELLS = (
    *(("runaway step", joint, phase) for joint in (1, 3) for phase in ("hold", "teaching")),
    *(("smooth bump", 1, phase) for phase in ("hold", "upwards", "late")),
    *(("drift +0.1", 1, "hold"), ("drift +0.3", 3, "hold")),
    *(("gradual swap", 1, "hold"), ("swap", 3, "upwards"), ("sign", 1, "late")),
)
READY_TIMEOUT = 20.0  # [s] until an arm that is not its model holds at the start of its policy
Line = tuple[str, bool]


def unreadable(count: int = 6) -> Falsifier:
    """Make some states unreadable: a fault after which the states are true."""
    left = [count]

    def falsify(state: Reading) -> Reading:
        left[0] -= 1
        return state if left[0] < 0 else state._replace(q=np.full(7, np.nan))

    return falsify


def observe(lab: Lab, driver: Driver, seconds: float = AFTER) -> Outcome:
    """Watch the arm for some time [s]; the person lets go at a fault. See `reactions.observe`."""
    driver.speeds.clear()
    driver.path.clear()
    noticed: list[int] = []

    def watch() -> bool:
        if not noticed and lab.label == "fault":
            noticed.append(len(driver.speeds))
            driver.release()
        return len(driver.speeds) * 0.002 >= seconds

    driver.play(2.0 * seconds, watch)
    begun = noticed[0] if noticed else 0
    calm = min(begun + (REST_TICKS if noticed else 0), len(driver.path) - 1)
    way, speeds = np.array(driver.path), driver.speeds
    travel, stop = (float(np.linalg.norm(way[at:] - way[at], axis=1).max()) for at in (calm, begun))
    reset = not noticed or driver.call(interface.RESET)
    kind = FaultKind.SOFTWARE if noticed else None  # the topic of torques does not say which
    at = noticed[0] if noticed else None
    return Outcome(kind, at, max(speeds), max(speeds[calm:], default=0.0), travel, stop, reset)


def ready(driver: Driver) -> bool:
    """Bring the arm to hold at the start of the policy; whether that was possible."""
    driver.falsify = lambda state: state
    driver.release()
    end = time.monotonic() + READY_TIMEOUT
    return driver.ready(lambda: time.monotonic() > end)


def refused(lab: Lab, driver: Driver, name: str, phase: str) -> Line:
    """An arm that does not reach a phase, because a fault ends every attempt, must still rest."""
    outcome = observe(lab, driver)
    good = acceptable(outcome, 0.0)
    return row(name, phase, 0.0, outcome, good), good


def cells(lab: Lab) -> Iterator[Line]:
    """A dozen false states of `benchmark.reaction_matrix`."""
    driver = Driver(lab)
    lab.controller()
    nominal: dict[str, float] = {}
    for name, joint, phase in CELLS:
        while phase not in nominal:
            driver.begin(phase)
            if (without := observe(lab, driver, 1.2)).fault is None:  # else a process was late
                nominal[phase] = without.peak
        driver.begin(phase)
        driver.falsify = LIES[name](joint)
        outcome = observe(lab, driver)
        good = outcome.fault is not None and outcome.peak <= nominal[phase] + MARGIN
        yield row(f"{name}, joint {joint + 1}", phase, nominal[phase], outcome, good), good


def faults(lab: Lab, arm: HiddenArm, name: str, phases: tuple[str, ...]) -> Iterator[Line]:
    """See `reactions.faults`; for one arm."""
    driver = Driver(lab, arm)
    lab.controller()
    for phase in phases:
        if not ready(driver):
            yield refused(lab, driver, f"{name}, did not get there", phase)
            continue
        driver.begin(phase)
        nominal = observe(lab, driver, 1.2).peak
        if not ready(driver):
            yield refused(lab, driver, f"{name}, did not get there again", phase)
            continue
        driver.begin(phase)
        driver.falsify = unreadable()
        outcome = observe(lab, driver)
        good = acceptable(outcome, nominal) and outcome.reset and outcome.fault is not None
        yield row(name, phase, nominal, outcome, good), good


def hands_off(lab: Lab, arm: HiddenArm, name: str) -> Iterator[Line]:
    """See `reactions.hands_off`; for one arm."""
    driver = Driver(lab, arm)
    lab.controller()
    if not ready(driver):
        yield refused(lab, driver, f"{name}, did not get there", "hands off")
        return
    driver.play(1.0)
    answer = lab.ask(interface.GRAVITY_COMPENSATION, True)
    driver.play(5.0, answer.done)
    given = answer.result()
    if given is None or not given.success:
        yield f"| {name} | hands off | {given or 'no answer'} | | | | | | good |", True
        return
    outcome = observe(lab, driver)
    good = outcome.travel < TRAVEL_MAX or (
        outcome.fault is not None and outcome.peak < HANDS_OFF_SPEED
    )
    yield row(name, "hands off", 0.0, outcome, good), good


@contextmanager
def new_lab() -> Iterator[Lab]:
    """A lab in a domain of its own: a killed controller stays announced in the one before."""
    with tempfile.TemporaryDirectory() as folder:
        lab = Lab(Path(folder))
        with lab.open():
            yield lab


def lines(case: str, count: int) -> Iterator[Line]:
    """All lines of a case; each arm has a controller of its own."""
    if case == "cells":
        with new_lab() as lab:
            yield from cells(lab)
        return
    for name, arm in all_arms(count):
        with new_lab() as lab:
            if case == "hands_off":
                yield from hands_off(lab, arm, name)
            else:
                yield from faults(lab, arm, name, ("upwards", "hold", "teaching"))


def main(arguments: list[str] | None = None) -> int:
    """Print a row for each case and phase; return 1 if the arm was not stopped."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    cases = ("cells", "faults", "hands_off")
    parser.add_argument("--cases", nargs="+", choices=cases, default=list(cases))
    parser.add_argument("--arms", type=int, default=12, help="number of drawn arms")
    given = parser.parse_args(arguments)
    scheduling._schedule(ARM)
    speeds = "peak (nominal) [m/s] | after 0.5 s"
    print(f"| case | phase | fault | {speeds} | travel [cm] | with the stop | reset | |")
    print("|---|---|---|---|---|---|---|---|---|")
    bad = 0
    for case in given.cases:
        for line, good in lines(case, given.arms):
            bad += not good
            print(line.replace("software after", "fault after"), flush=True)
    print(f"{bad} bad")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
