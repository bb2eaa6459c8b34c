# SPDX-License-Identifier: Apache-2.0
"""Reactions over DDS in real time, with the controller as a process.

    python -m benchmark.reactions_dds [--cases cells faults hands_off] [--arms 12]

A dozen cells of `benchmark.reaction_matrix`; arms that are not their model, after a fault of true
states and under gravity compensation that nobody guides. The largest speed of the tool is printed,
also that from 0.5 s after the fault on, and how far the tool travels in the 10 s after the fault.

The arm is simulated in this process and keeps the last torque, which tells the mode.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmark.false_states import OF_JOINT, Falsifier, N, Reading
from benchmark.hidden_arm import KNOWN, StandIn, draw
from benchmark.lab import ARM, Driver, Lab
from benchmark.loop import AFTER, TRAVEL_MAX, Outcome, acceptable
from benchmark.terminal import options, table_head, table_row
from hardware_sim.hidden_arm import HiddenArm
from wam_power_ros.ros import interface, scheduling

HANDS_OFF_SPEED = 0.3  # [m/s] largest speed of an arm that leaves by itself until it is stopped
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
        return state if left[0] < 0 else state._replace(q=np.full(N, np.nan))

    return falsify


def observe(driver: Driver) -> Outcome:
    """Watch the arm, then reset its fault."""
    found = driver.observe(AFTER)
    return found._replace(reset=found.noticed is None or driver.call(interface.RESET))


def line(name: str, phase: str, nominal: float, found: Outcome, good: bool) -> Line:
    """Line of the table, and whether it is good."""
    fault = "none" if found.noticed is None else f"fault after {2 * found.noticed} ms"
    speeds = f"{found.peak:.2f} ({nominal:.2f})", f"{found.rest:.3f}"
    ways = f"{100 * found.travel:.1f}", f"{100 * found.stop:.1f}"
    answers = "yes" if found.reset else "no", "good" if good else "**bad**"
    return table_row(name, phase, fault, *speeds, *ways, *answers), good


def ready(driver: Driver) -> bool:
    """Bring the arm to hold at the start of the policy; whether that was possible."""
    end = time.monotonic() + READY_TIMEOUT
    return driver.ready(lambda: time.monotonic() > end)


def refused(driver: Driver, name: str, phase: str) -> Line:
    """An arm that does not reach a phase, because a fault ends every attempt, must still rest."""
    found = observe(driver)
    return line(f"{name}, did not get there", phase, 0.0, found, acceptable(found, 0.0))


def cell(lab: Lab, name: str, joint: int, phase: str) -> Line:
    """A false state of `benchmark.reaction_matrix`."""
    driver = Driver(lab, StandIn())
    lab.controller()
    nominal = None
    while nominal is None:
        driver.begin(phase)
        if (without := driver.observe(1.2)).noticed is None:  # else a process was late
            nominal = without.peak
    driver.begin(phase)
    driver.falsify = OF_JOINT[name](joint)
    found = observe(driver)
    good = found.noticed is not None and found.peak <= nominal + MARGIN
    return line(f"{name}, joint {joint + 1}", phase, nominal, found, good)


def faults(lab: Lab, arm: HiddenArm, name: str) -> Iterator[Line]:
    """A fault of an arm that is not the model."""
    driver = Driver(lab, StandIn(arm))
    lab.controller()
    for phase in ("upwards", "hold", "teaching"):
        nominal = 0.0
        for falsify in (None, unreadable()):
            if not ready(driver):
                yield refused(driver, name, phase)
                break
            driver.begin(phase)
            if falsify is None:
                nominal = driver.observe(1.2).peak
                continue
            driver.falsify = falsify
            found = observe(driver)
            good = acceptable(found, nominal) and found.reset and found.noticed is not None
            yield line(name, phase, nominal, found, good)


def hands_off(lab: Lab, arm: HiddenArm, name: str) -> Iterator[Line]:
    """Gravity compensation of an arm that is not the model and that nobody touches."""
    driver = Driver(lab, StandIn(arm))
    lab.controller()
    if not ready(driver):
        yield refused(driver, name, "hands off")
        return
    driver.play(1.0)
    answer = lab.ask(interface.GRAVITY_COMPENSATION, True)
    driver.play(5.0, answer.done)
    given = answer.result()
    if given is None or not given.success:
        yield f"| {name} | hands off | {given or 'no answer'} | | | | | | good |", True
        return
    found = observe(driver)
    stayed = found.travel < TRAVEL_MAX
    good = stayed or (found.noticed is not None and found.peak < HANDS_OFF_SPEED)
    yield line(name, "hands off", 0.0, found, good)


def lines(case: str, count: int) -> Iterator[Line]:
    """All lines of a case; each cell and each arm has a lab of its own."""
    if case == "cells":
        for each in CELLS:
            with tempfile.TemporaryDirectory() as folder, Lab(Path(folder)).open() as lab:
                yield cell(lab, *each)
        return
    drawn = {f"drawn arm {seed}": draw(seed) for seed in range(9000, 9000 + count)}
    for name, arm in (KNOWN | drawn).items():
        with tempfile.TemporaryDirectory() as folder, Lab(Path(folder)).open() as lab:
            yield from (hands_off if case == "hands_off" else faults)(lab, arm, name)


def main() -> int:
    """Print a row for each case and phase; return 1 if the arm was not stopped."""
    given = options(__doc__, cases=["cells", "faults", "hands_off"], arms=12)
    scheduling._schedule(ARM)
    speeds = "peak (nominal) [m/s]", "after 0.5 s"
    print(
        table_head("case", "phase", "fault", *speeds, "travel [cm]", "with the stop", "reset", "")
    )
    bad = 0
    for case in given.cases:
        for text, good in lines(case, given.arms):
            bad += not good
            print(text, flush=True)
    print(f"{bad} bad")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
