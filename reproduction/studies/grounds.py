# SPDX-License-Identifier: Apache-2.0
"""The pancake with one demonstration: learners side by side, on easy and on hard ground.

    python -m reproduction.studies grounds --table grounds.csv

The reproduction of a novice's demonstration is never a true flip, so this task separates the
learners, unlike that of a practised demonstrator (`flip_sessions`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hardware_sim.scenes.flip import HOME, LEVEL
from reproduction.rivals.learners import RIVALS
from reproduction.studies.flip_sessions import NOVICE, session
from reproduction.studies.table import Row, Table
from wam_power_ros.tasks.flip.frames import PANCAKE_RADIUS

BUDGET = 60  # rollouts
RETESTS = 30  # of the final policy
KINDS = ("true_flip", "landed")  # of re-tests
SOLVED = 27  # or more true flips among the re-tests of a solved session
FIRST = 31105  # seed; this and those after it, and 7001 to 7030, were not used for tuning


def _posture(tilt: float, roll: float = 0.0) -> list[float]:
    """Home posture with the pan tilted forward and rolled [degrees], as joint angles [rad]."""
    q = LEVEL.tolist()
    q[5] += math.radians(tilt)
    q[6] += math.radians(roll)
    return q


TURNED = {  # the arm stands turned about the vertical: joint 1 begins elsewhere [degrees]
    f"joint 1 at {angle} degrees": {"condition": {"home": [math.radians(angle), *HOME[1:]]}}
    for angle in (-90, -45, 30, 90)
}
WRONG = {  # cameras whose stamps or frame are other than the tracker believes
    "stamps 20 ms early": {"latency_offset": 0.02},
    "stamps 20 ms late": {"latency_offset": -0.02},
    "stamps 40 ms late": {"latency_offset": -0.04},
    "frame 2 cm off": {"world_to_base": (0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)},
}
# Not on the usual grounds: seen by a camera with tags, or wrongly; turned; changing.
OTHER = {
    "camera with tags": {"condition": {"mocap": {"camera": True}}},
    **{name: {"condition": {"tracker": wrong}} for name, wrong in WRONG.items()},
    **TURNED,
    **{f"{what} grows by 3 %": {"drift": what} for what in ("drag", "friction", "mass")},
}
# Arguments of `flip_sessions.session` by ground; one demonstration of a novice unless it says more.
# The unknown world is drawn from the seed.
_DIFFERENCES: Mapping[str, Mapping[str, Any]] = {
    "novice": {},
    "hand 4.5 rad/s": {"pitch_rate": 4.5},
    "hand 4.0 rad/s": {"pitch_rate": 4.0},
    "hand 3.0 rad/s": {"pitch_rate": 3.0},
    "late twist": {"habit": "late twist"},
    "30 % slower": {"habit": "slow"},
    "tremor": {"habit": "tremor"},
    "level pan": {"condition": {"level": True}},
    "10 degrees of tilt": {"condition": {"home": _posture(10.0)}},
    "rolled by 3 degrees": {"condition": {"home": _posture(25.0, 3.0)}},
    "pancake of 0.08 m": {"condition": {"body_size": 0.08 / PANCAKE_RADIUS}},
    "pancake of 0.12 m": {"condition": {"body_size": 0.12 / PANCAKE_RADIUS}},
    "unknown world": {"condition": {"unknown": "session"}},
    **OTHER,
}
GROUNDS = {
    name: {"demonstrations": 1, "pitch_rate": NOVICE, **different}
    for name, different in _DIFFERENCES.items()
}


def of_preset(told: str, preset: str, learner: str = "", **changes: Any) -> Row:  # noqa: ANN401
    """A learner of the name, that of a preset without one, in sessions of this preset."""
    if learner:
        changes["learner"] = {"name": RIVALS.get(learner, learner)}
    return Row(told, {"name": preset, "changes": changes})


_COMMON = {"budget": BUDGET, "retests": RETESTS}
_PLANNER = "return, landing error, rotation, a model of the toss"
LEARNERS = {
    "model_based": of_preset(_PLANNER, "model_based", **_COMMON),
    "sixteen_springs": of_preset(_PLANNER, "model_based", springs=16, **_COMMON),
    "hindsight": of_preset("return, landing error, rotation", "hindsight", **_COMMON),
    "corrections": of_preset("landing error, rotation", "corrections_only", **_COMMON),
    "power": of_preset("return", "return_only", **_COMMON),
    **{
        name: of_preset("return", "return_only", name, **_COMMON)
        for name in ("cma_es", "pi2_bb", "random")
    },
}


def row(found: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of one session.

    Returns:
        "true", "landed": true flips, and re-tests turned over and caught, of "retests"; "rollouts":
        number of rollouts, those that confirm included; "confirmed": whether they did.
    """
    return {
        "true": sum(run["true_flip"] for run in found["retests"]),
        "landed": sum(run["landed"] for run in found["retests"]),
        "retests": len(found["retests"]),
        "rollouts": found["used"],
        "confirmed": found["ended_by"] == "confirmation",
    }


def line(sessions: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Statistics of the sessions of a learner on a ground.

    Returns:
        "sessions": their number; "solved": those with at least SOLVED true flips in the re-tests;
        "landed": those with as many that turned over and were caught, however far in the air;
        "confirmed": those that their stopping rule ended; "wrong": those of them that are not
        solved; "rollouts": median and worst decile of their number; "true": mean and lowest decile
        of the share of true flips in the re-tests.
    """
    true, landed = np.array([[_share(s["retests"], k) for k in KINDS] for s in sessions]).T
    confirmed = np.array([s["ended_by"] == "confirmation" for s in sessions])
    used, solved = [s["used"] for s in sessions], true >= SOLVED / RETESTS
    worst = np.quantile(used, 0.9, method="higher")
    return {
        "sessions": len(sessions),
        "solved": int(solved.sum()),
        "landed": int((landed >= SOLVED / RETESTS).sum()),
        "confirmed": int(confirmed.sum()),
        "wrong": int((confirmed & ~solved).sum()),
        "rollouts": (float(np.median(used)), float(worst)),
        "true": (float(true.mean()), float(np.quantile(true, 0.1))),
    }


def _share(runs: Sequence[Mapping[str, Any]], outcome: str) -> float:
    """Share of runs with an outcome; 0 for a session without a final policy."""
    return float(np.mean([run[outcome] for run in runs] or [0]))


TABLE = Table(
    GROUNDS,
    LEARNERS,
    range(FIRST, FIRST + 10),
    session,
    line,
    (GROUNDS.keys() - {"hand 4.0 rad/s", *OTHER}, ("model_based", "hindsight")),
    row,
)
