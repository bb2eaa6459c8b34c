# SPDX-License-Identifier: Apache-2.0
"""The pancake taught by a novice with one demonstration: learners and baselines side by side.

    python -m reproduction.studies.novice [--seeds N] [--only ROW ...] [--case CASE]

prints a row for each. The reproduction of such a demonstration is never a true flip, so this task
separates the learners, unlike that of a practised demonstrator (`flip_sessions`).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from reproduction import jobs as job_cache
from reproduction.jobs import Job
from reproduction.studies.flip_sessions import NOVICE, session

BUDGET = 60  # rollouts
RETESTS = 30  # of the final policy
SOLVED = 27  # or more true flips among the re-tests of a solved session
HELD_OUT = range(7001, 7031)  # seeds not used for tuning


class Row(NamedTuple):
    """A line of the table.

    Attributes:
        told: Measurements of a rollout that the learner receives.
        preset: Name of the preset of the task `flip`.
        changes: Changes to it.
    """

    told: str
    preset: str
    changes: Mapping[str, Any]


ROWS = {
    "model_based": Row("return, landing error, rotation, a model of the toss", "model_based", {}),
    "hindsight": Row("return, landing error, rotation", "hindsight", {}),
    "corrections": Row("landing error, rotation", "corrections_only", {}),
    "power": Row("return", "return_only", {}),
    "cma_es": Row("return", "return_only", {"learner": {"name": "cma_es"}}),
    "pi2_bb": Row("return", "return_only", {"learner": {"name": "pi2_bb"}}),
    "random": Row("return", "return_only", {"learner": {"name": "random"}}),
}
# Arguments of a session in each case. "unknown" and "varied": worlds drawn from the seed, one for
# the session or one for each rollout.
CASES: Mapping[str, Mapping[str, Any]] = {
    "novice": {"pitch_rate": NOVICE},
    "weak": {"pitch_rate": 4.0},
    "level": {"pitch_rate": NOVICE, "condition": {"level": True}},
    "unknown": {"pitch_rate": NOVICE, "condition": {"unknown": "session"}},
    "varied": {"pitch_rate": NOVICE, "condition": {"unknown": "rollout"}},
}
# Final policies of the default are run again in as many other worlds as there are re-tests.
ELSEWHERE = {"carried": {"elsewhere": {"unknown": "rollout"}}, "repeats": RETESTS}


def study(row: str, case: str) -> str:
    """Name of the study of a row in a case."""
    return f"{case}-{row}"


def jobs(
    seeds: Sequence[int], rows: Sequence[str] = tuple(ROWS), case: str = "novice"
) -> list[Job]:
    """Sessions of every row, ordered by seed."""
    return [
        Job(
            study(name, case),
            f"seed-{seed}",
            session,
            {
                "seed": seed,
                "name": ROWS[name].preset,
                "demonstrations": 1,
                "changes": {"budget": BUDGET, "retests": RETESTS, **ROWS[name].changes},
                **CASES[case],
                **(ELSEWHERE if name == "model_based" else {}),
            },
        )
        for seed in seeds
        for name in rows
    ]


def line(sessions: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Statistics of the sessions of a row.

    Returns:
        "sessions": their number; "reproduced": those whose first reproduction was a true flip;
        "solved": those with at least SOLVED true flips in the re-tests; "landed": those with as
        many that turned over and were caught, however far in the air; "confirmed": those that a
        streak of successes ended; "wrong": those of them that are not solved; "to_streak": median
        number of rollouts before that streak; "true": mean and lowest decile of the share of true
        flips in the re-tests; "elsewhere": the same for the runs in other worlds, None without
        such runs.
    """
    true = np.array([_share(s["retests"]) for s in sessions])
    landed = np.array([_share(s["retests"], "landed") for s in sessions])
    elsewhere = np.array([_share(s["carried"].get("elsewhere")) for s in sessions])
    ended = [s for s in sessions if s["ended_by"] == "confirmation"]
    before = [s["used"] - s["confirmed"] for s in ended]
    return {
        "sessions": len(sessions),
        "reproduced": sum(bool(s["trials"][0]["true_flip"]) for s in sessions),
        "solved": int(np.sum(true >= SOLVED / RETESTS)),
        "landed": int(np.sum(landed >= SOLVED / RETESTS)),
        "confirmed": len(ended),
        "wrong": sum(_share(s["retests"]) < SOLVED / RETESTS for s in ended),
        "to_streak": float(np.median(before)) if before else None,
        "true": _mean_and_decile(true),
        "elsewhere": _mean_and_decile(elsewhere) if any(s["carried"] for s in sessions) else None,
    }


def _share(runs: Sequence[Mapping[str, Any]] | None, outcome: str = "true_flip") -> float:
    """Share of runs with an outcome; 0 for a session without a final policy."""
    return float(np.mean([run[outcome] for run in runs or []] or [0]))


def _mean_and_decile(shares: np.ndarray) -> tuple[float, float]:
    return float(shares.mean()), float(np.quantile(shares, 0.1))


def main() -> None:
    """Run the sessions of every row and print their statistics."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--folder", type=Path, default=Path("novice"))
    parser.add_argument("--seeds", type=int, default=len(HELD_OUT), help="of each row, at most 30")
    parser.add_argument("--only", nargs="+", choices=ROWS, default=list(ROWS), metavar="ROW")
    parser.add_argument("--case", choices=CASES, default="novice")
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    wanted = jobs(HELD_OUT[: args.seeds], args.only, args.case)
    results = job_cache.run(wanted, args.folder, workers=args.workers)
    for name in args.only:
        found = line(list(results[study(name, args.case)].values()))
        sys.stdout.write(f"{name} (learns from {ROWS[name].told}): {found}\n")


if __name__ == "__main__":
    main()
