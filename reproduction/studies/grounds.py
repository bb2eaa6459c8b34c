# SPDX-License-Identifier: Apache-2.0
"""Learners on easy and on hard ground: other demonstrators, pans, pancakes and arms.

    python -m reproduction.studies.grounds [--seeds N] [--only GROUND ...] [--learners NAME ...]

prints a row for each ground and learner, and with `--table FILE` writes one for each session.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hardware_sim.scenes.flip import LEVEL
from reproduction import jobs as job_cache
from reproduction.jobs import Job
from reproduction.studies.flip_sessions import NOVICE, session
from reproduction.studies.novice import BUDGET, RETESTS, SOLVED
from wam_power_ros.tasks.flip.frames import PANCAKE_RADIUS

HELD_OUT = range(31105, 31205)  # seeds not used for tuning


def _posture(tilt: float, roll: float = 0.0) -> list[float]:
    """Home posture with the pan tilted forward and rolled [degrees], as joint angles [rad]."""
    q = LEVEL.tolist()
    q[5] += math.radians(tilt)
    q[6] += math.radians(roll)
    return q


# Arguments of `flip_sessions.session` by ground; one demonstration of a novice unless it says more.
GROUNDS: Mapping[str, Mapping[str, Any]] = {
    "novice": {},
    "hand 4.5 rad/s": {"pitch_rate": 4.5},
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
}


# Learner -> preset and changes to it.
LEARNERS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "model_based": ("model_based", {}),
    "hindsight": ("hindsight", {}),
    "power": ("return_only", {}),
    "bayesian_optimization": ("return_only", {"learner": {"name": "bayesian_optimization"}}),
}


def arguments(ground: str) -> dict[str, Any]:
    """Arguments of `flip_sessions.session` on a ground."""
    return {"demonstrations": 1, "pitch_rate": NOVICE, **GROUNDS[ground]}


def jobs(seeds: Sequence[int], grounds: Sequence[str], learners: Sequence[str]) -> list[Job]:
    """Sessions of every learner on every ground, ordered by seed."""
    wanted = []
    for seed in seeds:
        for ground in grounds:
            for learner in learners:
                name, changes = LEARNERS[learner]
                settings = {"budget": BUDGET, "retests": RETESTS, **changes}
                own = {"seed": seed, "name": name, "changes": settings, **arguments(ground)}
                wanted.append(Job(study(ground, learner), f"seed-{seed}", session, own))
    return wanted


def study(ground: str, learner: str) -> str:
    """Name of the study of a learner on a ground."""
    plain = "".join(c if c.isalnum() or c == "." else "-" for c in ground)
    return f"{plain}-{learner}"


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


def line(rows: Sequence[Mapping[str, Any]]) -> str:
    """Figures of all sessions of a learner on a ground; "wrong" are confirmed and not solved."""
    solved = sum(each["true"] >= SOLVED for each in rows)
    landed = sum(each["landed"] >= SOLVED for each in rows)
    used = [each["rollouts"] for each in rows]
    confirmed = [each for each in rows if each["confirmed"]]
    wrong = sum(each["true"] < SOLVED for each in confirmed)
    return (
        f"{solved} of {len(rows)} solved, {landed} turned over and caught, {len(confirmed)} "
        f"confirmed, {wrong} of them wrong; rollouts, confirmation included: median "
        f"{np.median(used):g}, worst decile {np.quantile(used, 0.9, method='higher'):g}"
    )


def main() -> None:
    """Run the sessions and print a line for every ground and learner."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--folder", type=Path, default=Path("grounds"))
    parser.add_argument("--seeds", type=int, default=10, help="of each row, at most 100")
    parser.add_argument("--only", nargs="+", choices=GROUNDS, default=list(GROUNDS))
    parser.add_argument(
        "--learners", nargs="+", choices=LEARNERS, default=["model_based", "hindsight"]
    )
    parser.add_argument("--table", type=Path, help="CSV file, a line for each session")
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    wanted = jobs(HELD_OUT[: args.seeds], args.only, args.learners)
    results = job_cache.run(wanted, args.folder, workers=args.workers)
    table = []
    for ground in args.only:
        for learner in args.learners:
            rows = {key: row(found) for key, found in results[study(ground, learner)].items()}
            sys.stdout.write(f"{ground}, {learner}: {line(list(rows.values()))}\n")
            table += [
                {"ground": ground, "learner": learner, "seed": key.removeprefix("seed-"), **each}
                for key, each in rows.items()
            ]
    if args.table is not None:
        with args.table.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(table[0]))
            writer.writeheader()
            writer.writerows(table)


if __name__ == "__main__":
    main()
