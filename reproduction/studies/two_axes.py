# SPDX-License-Identifier: Apache-2.0
"""What the planner knows of the slopes, with and without PoWER: a novice's flip and swing.

python -m reproduction.studies two_axes --table two_axes.csv
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from reproduction.jobs import Job, study_of
from reproduction.rivals.slopes import ALONE, FIXED, SHARPENED, LessInformed, Newton
from reproduction.studies import ball_in_cup, flip_sessions, grounds

FLIPS = {"flip": "novice", "flip, 30 % slower": "30 % slower"}  # place -> ground
PLACES = (*FLIPS, "ball_in_cup")  # which predicts nothing
HELD_OUT = range(10100, 10120)  # seeds not used for tuning
RETESTS, SOLVED = 10, 9  # of the final policy; or more that succeed in a solved session
_NAME = f"{LessInformed.__module__}:"
KNOWN: Mapping[str, tuple[str, Mapping[str, Any]]] = {  # what it is told -> how it is set up
    f"{slopes}{behind}": (told, {"name": f"{_NAME}LessInformed", **known, **power})
    for slopes, told, known in (
        ("fixed", "errors, fixed slopes", FIXED),
        ("sharpened", "errors, slopes that rollouts sharpen", SHARPENED),
        ("predict", "errors, slopes, predictions", {}),
    )
    for behind, power in (("", ALONE), ("+power", {}))
}
LEARNERS = {"newton": ("errors, fixed slopes", {"name": f"{_NAME}{Newton.__name__}"}), **KNOWN}


def session(place: str, seed: int, learner: Mapping[str, Any]) -> dict[str, Any]:
    """Run a session of the preset `model_based`, but with a learner; return its figures.

    Returns:
        "first": its first true success; "rollouts": their number, confirmation included;
        "confirmed"; "true": re-tests that are true, and "retests".
    """
    changes = {"learner": learner, "retests": RETESTS}
    if place in FLIPS:
        changes["budget"] = grounds.BUDGET
        own = grounds.arguments(FLIPS[place])
        found = flip_sessions.session(seed, "model_based", changes=changes, **own)
        tried, tested = ([bool(r["true_flip"]) for r in found[k]] for k in ("trials", "retests"))
        confirmed = found["ended_by"] == "confirmation"
    else:
        found = ball_in_cup.session(seed, "model_based", changes)
        kinds = [r["kind"] == "retest" for r in found["trials"]]
        caught = [bool(r["caught"]) for r in found["trials"]]
        tried = [c for c, again in zip(caught, kinds, strict=True) if not again]
        tested = [c for c, again in zip(caught, kinds, strict=True) if again]
        confirmed = found["confirmed"]
    return {
        "first": tried.index(True) + 1 if True in tried else None,
        "rollouts": found["used"],
        "confirmed": confirmed,
        "true": sum(tested),
        "retests": len(tested),
    }


def jobs(seeds: Sequence[int], places: Sequence[str], learners: Sequence[str]) -> list[Job]:
    """Sessions of every learner at every place, ordered by seed."""
    return [
        Job(
            study_of(place, learner),
            f"seed-{seed}",
            session,
            {"place": place, "seed": seed, "learner": dict(LEARNERS[learner][1])},
        )
        for seed in seeds
        for place in places
        for learner in learners
    ]


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
