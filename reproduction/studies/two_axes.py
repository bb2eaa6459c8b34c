# SPDX-License-Identifier: Apache-2.0
"""What the planner knows of the slopes, with and without PoWER: a novice's flip and swing.

python -m reproduction.studies two_axes --table two_axes.csv
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from reproduction.rivals import slopes
from reproduction.studies import ball_in_cup, flip_sessions, grounds
from reproduction.studies.table import Row, Table

PLACES = ("flip", "ball_in_cup")  # of which the latter predicts nothing
HELD_OUT = range(18000, 18020)  # seeds not used for tuning
RETESTS, SOLVED = 10, 9  # of the final policy; or more that succeed in a solved session


def _told(told: str, name: str, **settings: Any) -> Row:  # noqa: ANN401
    return Row(told, {"learner": {"name": f"{slopes.__name__}:{name}", **settings}})


LEARNERS = {"newton": _told("errors, fixed slopes", "Newton")} | {
    f"{name}{behind}": _told(told, "LessInformed", **known, **power)
    for name, told, known in (
        ("fixed", "errors, fixed slopes", slopes.FIXED),
        ("sharpened", "errors, slopes that rollouts sharpen", slopes.SHARPENED),
        ("predict", "errors, slopes, predictions", {}),
    )
    for behind, power in (("", slopes.ALONE), ("+power", {}))
}


def session(place: str, seed: int, learner: Mapping[str, Any]) -> dict[str, Any]:
    """Run a session of `model_based` with another learner; its figures, "first" true success."""
    changes: dict[str, Any] = {"learner": learner, "retests": RETESTS}
    if place == "flip":
        changes["budget"] = grounds.BUDGET
        own = grounds.GROUNDS["novice"]
        found = flip_sessions.session(seed, "model_based", changes=changes, **own)
        runs = [(r["kind"], bool(r["true_flip"])) for r in found["trials"] + found["retests"]]
    else:
        found = ball_in_cup.session(seed, "model_based", changes)
        runs = [(r["kind"], bool(r["caught"])) for r in found["trials"]]
    tried = [true for kind, true in runs if kind != "retest"]
    return {
        "first": tried.index(True) + 1 if True in tried else None,
        "rollouts": found["used"],
        "confirmed": found["confirmed"] > 0,
        "true": sum(true for kind, true in runs if kind == "retest"),
        "retests": len(runs) - len(tried),
    }


def line(sessions: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Statistics of the sessions of a learner at a place: see `session` and SOLVED.

    "wrong" are those that were confirmed and are not solved; "rollouts" median and worst decile.
    """
    solved = [each["true"] >= SOLVED for each in sessions]
    used, first = ([each[key] or np.inf for each in sessions] for key in ("rollouts", "first"))
    return {
        "sessions": len(sessions),
        "solved": sum(solved),
        "confirmed": sum(each["confirmed"] for each in sessions),
        "wrong": sum(e["confirmed"] > s for e, s in zip(sessions, solved, strict=True)),
        "first success": float(np.median(first)),
        "rollouts": np.quantile(used, (0.5, 0.9), method="higher").tolist(),
    }


TABLE = Table({p: {"place": p} for p in PLACES}, LEARNERS, HELD_OUT, session, line, row=dict)
