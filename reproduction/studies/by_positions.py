# SPDX-License-Identifier: Apache-2.0
"""The same sessions by torques and by positions, which the arm follows late.

python -m reproduction.studies by_positions [--only PLACE ...] [--learners OUTPUT ...]
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from reproduction.studies.table import Row, Table
from wam_power_ros.in_process import learn
from wam_power_ros.params import overlay
from wam_power_ros.practice.settings import preset

HELD_OUT = range(12000, 12020)  # seeds not used for tuning
PERIOD = 0.002  # [s] of states


class Servo(NamedTuple):
    """A position servo: its delay, the lag of its low-pass, and the period of set points [s]."""

    delay: float
    lag: float
    set_points: float = 0.0  # one for each state
    told: bool = False  # whether delay and lag were measured, as by `wam-power commission`


PLACES = {  # task and set-ups; a flip is faster than the joints of a UR5e
    "flip, WAM": ("flip", ()),
    "cup, WAM": ("ball_in_cup", ()),
    "reach, WAM": ("reach", ()),
    "reach, UR5e": ("reach", ("ur", "full_speed")),
    "reach, Gen3": ("reach", ("gen3", "full_speed")),  # these two take no torques
    "reach, xArm 7": ("reach", ("xarm7", "full_speed")),
}
OUTPUTS = {
    "torques": None,
    "10ms": Servo(0.01, 0.01),
    "40ms": Servo(0.04, 0.02, 0.008),
    "80ms": Servo(0.08, 0.04),
    "80ms-told": Servo(0.08, 0.04, told=True),
}


def session(seed: int, place: str, output: str) -> dict[str, Any]:
    """Teach and practise a task in simulation; return what became of it."""
    (task, names), servo = PLACES[place], OUTPUTS[output]
    names = (*names, *(("position",) if servo else ()))
    setup = overlay.setup(names, simulated=True, task=task)
    setup = setup.changed({"wam_sim": {"seed": seed}})
    if servo is not None:
        ticks = round(servo.delay / PERIOD)
        driver = {"command_delay_ticks": ticks, "servo_lag": servo.lag}
        controller = {"set_point_period": servo.set_points}
        if servo.told:
            controller |= {"servo_delay": servo.delay, "servo_lag": servo.lag}
        setup = setup.changed({"wam_sim": driver, "torque_controller": controller})
    with tempfile.TemporaryDirectory() as folder:
        settings, count = preset(task), 3 if task == "flip" else 1  # demonstrations
        try:
            *_, last = learn.run(Path(folder) / "session", setup, settings, seed, count)
        except ValueError as error:
            return {"solved": False, "used": 0, "retests": 0, "faults": 0, "why": str(error)}
        trials = [each for each in last.records if each.kind != "retest"]
        retests = [each for each in last.records if each.kind == "retest"]
    passed = [each.success for each in retests]
    return {
        "solved": bool(passed) and all(passed),
        "used": len(trials),
        "retests": sum(map(bool, passed)),
        "faults": sum(bool(each.fault) for each in trials),
        "why": "",
    }


def line(sessions: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Sessions without a failed re-test, and rollouts: median and range."""
    used = [each["used"] for each in sessions]
    spread = {"median": float(np.median(used)), "least": min(used), "most": max(used)}
    return {"solved": sum(each["solved"] for each in sessions), "rollouts": spread}


TABLE = Table(
    {place: {"place": place} for place in PLACES},
    {output: Row("rollouts", {"output": output}) for output in OUTPUTS},
    HELD_OUT,
    session,
    line,
)
