# SPDX-License-Identifier: Apache-2.0
"""Faults and reactions over DDS in real time, with the controller as a process.

    python -m benchmark.reactions_dds [--cases stale ended false_states cells]

stale: states stop at a random moment of the period. ended: the controller is ended or deactivated
in a rollout. false_states: all of `benchmark.false_states.FALSE_STATES`, and a second publisher
that repeats the states 6 ms late, in each phase of a session, for 1.2 s. cells: a dozen cells of
`benchmark.reaction_matrix`.

The arm is simulated in this process and keeps the last torque, which tells the mode. The largest
speed of the tool is printed, also that from 0.5 s after the fault on, and how far the tool travels
after the fault, in 10 s.
"""

from __future__ import annotations

import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from lifecycle_msgs.msg import Transition

from benchmark.false_states import FALSE_STATES, OF_JOINT, Falsifier
from benchmark.hidden_arm import StandIn
from benchmark.lab import ARM, WATCH_TIME, Driver, Lab, inject
from benchmark.loop import AFTER, PHASES, Outcome, stopped
from benchmark.terminal import options, table_head, table_row
from wam_power_ros.control.safety import REST_SPEED
from wam_power_ros.ros import interface, scheduling

MARGIN = 0.2  # [m/s] above the nominal speed: 0.1, and what a busy machine adds
CELLS = (
    *(("runaway step", joint, phase) for joint in (1, 3) for phase in ("hold", "teaching")),
    *(("smooth bump", 1, phase) for phase in ("hold", "upwards", "late")),
    *(("drift +0.1", 1, "hold"), ("drift +0.3", 3, "hold")),
    *(("gradual swap", 1, "hold"), ("swap", 3, "upwards"), ("sign", 1, "late")),
)
RELAY = "states relayed 6 ms late"
STOPS, ENDS = 100, 17  # repeats; the latter of each way to end the controller
LATEST = 8.0  # [ms] from the last state to the first torque without one
OFF_GRAVITY = 0.5  # [N m] of the last torque of a controller that ends
Line = tuple[str, bool]


def line(name: str, phase: str, nominal: float, found: Outcome, good: bool) -> Line:
    """Line of the table, and whether it is good."""
    fault = "none" if found.noticed is None else f"fault after {2 * found.noticed} ms"
    speeds = f"{found.peak:.2f} ({nominal:.2f})", f"{found.rest:.3f}"
    ways = f"{100 * found.travel:.1f}", f"{100 * found.stop:.1f}"
    return told(good, name, phase, fault, *speeds, *ways, "yes" if found.reset else "no")


def told(good: bool, *cells: object) -> Line:
    """Line of the table of these cells, of which the last ones may be missing."""
    return table_row(*cells, *[""] * (8 - len(cells)), "good" if good else "**bad**"), good


def started(lab: Lab) -> Driver:
    """An arm, and a controller that is started for it."""
    lab.controller()
    return Driver(lab, StandIn())


def observed(driver: Driver, found: Outcome) -> Outcome:
    """What was found, after the reset of its fault."""
    return found._replace(reset=found.noticed is None or driver.call(interface.RESET))


def nominal_peak(driver: Driver, phase: str) -> float:
    """Largest speed of the tool in a phase with true states [m/s]."""
    while True:
        driver.begin(phase)
        if (found := driver.observe(WATCH_TIME)).noticed is None:  # else a process was late
            return found.peak


def stale(lab: Lab) -> Iterator[Line]:
    """States stop: the first torque without them must come soon."""
    driver = started(lab)
    rng, first = np.random.default_rng(21), []
    for _ in range(STOPS):
        driver.ready()
        driver.play(rng.uniform(0.02, 0.1))
        lab.spin(0.003, lambda: lab.torques[-1][1].stamp_ns == driver.stamp_ns)
        del lab.torques[:-1]
        lost = driver.published_ns
        lab.spin(0.012, lambda: len(lab.torques) > 1)
        first.append((lab.torques[1][0] - lost) * 1e-6 if len(lab.torques) > 1 else np.inf)
        driver.stamp_ns += time.monotonic_ns() - lost
    worst = f"torque after {max(first):.1f} ms at most, median {np.median(first):.1f}"
    yield told(max(first) <= LATEST, f"states stop, {STOPS} times", "hold", worst)


def ended(lab: Lab) -> Iterator[Line]:
    """The controller is ended or deactivated in a rollout; its last torque must hold the arm."""
    driver, rng = Driver(lab, StandIn()), np.random.default_rng(21)
    for how in (signal.SIGTERM, signal.SIGINT, None):
        rests, wrong = [], []
        for _ in range(ENDS):
            controller = lab.controller()
            driver.begin("early")
            driver.play(rng.uniform(0.0, 0.8))
            if how is None:
                off = Transition(id=Transition.TRANSITION_DEACTIVATE)
                lab.ask("/torque_controller/change_state", off)
            else:
                controller.process.send_signal(how)
            driver.play(0.5)
            driver.speeds.clear()
            driver.play(0.5)
            rests.append(max(driver.speeds))
            wrong.append(float(np.abs(lab.torques[-1][1].tau - driver.plant.gravity()).max()))
            lab.end(controller)
        good = max(rests) < REST_SPEED and max(wrong) < OFF_GRAVITY
        name = "deactivated" if how is None else how.name
        worst = f"{max(wrong):.2f} N m off gravity"
        yield told(good, f"{name}, {ENDS} times", "rollout", worst, "", f"{max(rests):.3f}")


def false_state(lab: Lab, name: str, make: Callable[[], Falsifier]) -> Iterator[Line]:
    """False states, or a relay of true ones, in every phase."""
    driver, relayed = started(lab), 3 if name == RELAY else 0
    for phase in PHASES:
        nominal = nominal_peak(driver, phase)
        found = inject(driver, lab, phase, make(), relayed)
        driver.falsify, driver.relayed = lambda state: state, 0
        driver.play(2.0)  # true states, for so long that a reset is allowed
        good = stopped(found, nominal) and (found.noticed is not None or not relayed)
        yield line(name, phase, nominal, observed(driver, found), good)


def cell(lab: Lab, name: str, joint: int, phase: str) -> Iterator[Line]:
    """A false state of `benchmark.reaction_matrix`."""
    driver = started(lab)
    nominal = nominal_peak(driver, phase)
    found = observed(driver, inject(driver, lab, phase, OF_JOINT[name](joint), seconds=AFTER))
    good = found.noticed is not None and found.peak <= nominal + MARGIN
    yield line(f"{name}, joint {joint + 1}", phase, nominal, found, good)


def lines(case: str) -> Iterator[Line]:
    """All lines of a case; each kind of false state and each cell has its own lab."""
    kinds = {**FALSE_STATES, RELAY: lambda: lambda state: state}
    measures: dict[str, list[Callable[[Lab], Iterator[Line]]]] = {
        "stale": [stale],
        "ended": [ended],
        "false_states": [partial(false_state, name=name, make=kinds[name]) for name in kinds],
        "cells": [partial(cell, name=name, joint=j, phase=phase) for name, j, phase in CELLS],
    }
    for measure in measures[case]:
        with tempfile.TemporaryDirectory() as folder, Lab(Path(folder)).open() as lab:
            yield from measure(lab)


def main() -> int:
    """Print a row for each case and phase; return 1 if the arm was not stopped."""
    given = options(__doc__, cases=["stale", "ended", "false_states", "cells"])
    scheduling._schedule(ARM)
    speeds = "peak (nominal) [m/s]", "after 0.5 s"
    print(
        table_head("case", "phase", "fault", *speeds, "travel [cm]", "with the stop", "reset", "")
    )
    bad = 0
    for case in given.cases:
        for text, good in lines(case):
            bad += not good
            print(text, flush=True)
    print(f"{bad} bad")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
