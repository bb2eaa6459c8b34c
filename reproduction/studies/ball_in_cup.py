# SPDX-License-Identifier: Apache-2.0
"""Ball-in-a-cup taught by a person who misses, with one demonstration: learners side by side.

    python -m reproduction.studies.ball_in_cup [--seeds N] [--only ROW ...] [--spread S]

prints a row for each.
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
from reproduction.rivals.learners import RIVALS
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.params import overlay
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.ball_in_cup.task import BallInCup

TASK = BallInCup.name
RETESTS = 30  # of the final policy
SOLVED = 27  # or more of them in the cup in a solved session
NEAR = 0.05  # [m] beside the middle of the cup, from where a ball usually falls into it
HELD_OUT = range(9200, 9220)  # seeds not used for tuning


class Row(NamedTuple):
    """A line of the table.

    Attributes:
        told: Measurements of a rollout that the learner receives.
        preset: Name of the preset.
        learner: Name of the learner, "" for that of the preset.
    """

    told: str
    preset: str
    learner: str = ""


ROWS = {
    "model_based": Row("miss, its rough slopes", "model_based"),
    "cup": Row("return, miss", "cup"),
    "corrections": Row("miss", "corrections_only"),
    "power": Row("return", "return_only"),
    "cma_es": Row("return", "return_only", "cma_es"),
    "pi2_bb": Row("return", "return_only", "pi2_bb"),
    "adaptive_power": Row("return", "return_only", "adaptive_power"),
    "random": Row("return", "return_only", "random"),
    "kober": Row("return", "kober"),
}


def session(
    seed: int, name: str, learner: str = "", spread: float | None = None, **changes: int
) -> dict[str, Any]:
    """Run a session from its demonstration to its re-tests; return plain data.

    It ends with the re-test that decides that it is not solved.

    Args:
        seed: Seed of the demonstrator, the stand-in and the exploration.
        name: Name of the preset.
        learner: Name of the learner, "" for that of the preset.
        spread: Spread of the demonstrations; None for that of the task's set-up.
        **changes: Changes to the preset.
    """
    own = {"seed": seed} if spread is None else {"seed": seed, "spread": spread}
    environment = Environment.of(overlay.setup(task=TASK).changed({"wam_sim": own}))
    script = environment.world.scene.script(np.random.default_rng([seed, 0]))
    recorded = environment.demonstrate(script, "demonstration-0")
    demonstration = BallInCup.demonstration_of(environment.arm, *recorded)
    policy = BallInCup.policy_of([demonstration], "demonstration-1")
    settings = preset(
        TASK, name, {"name": RIVALS.get(learner, learner)} if learner else None, **changes
    )
    practice = Practice(settings, {}, [policy], seed, environment)
    records, failed = [], 0
    for record in environment.practise(practice):
        records.append(record)
        failed += record.kind == "retest" and not record.truth["caught"]
        if failed > RETESTS - SOLVED:
            break
    return {
        "used": practice.used,
        "stopped": practice.stopped,
        "confirmed": practice.used < settings.practice.budget or "in a row" in practice.stopped,
        "trials": [
            {
                "kind": record.kind,
                "ret": record.ret,
                "fault": record.fault,
                "distance": record.truth["distance"],
                "caught": record.truth["caught"],
            }
            for record in records
        ],
    }


def jobs(
    seeds: Sequence[int], rows: Sequence[str] = tuple(ROWS), spread: float | None = None
) -> list[Job]:
    """Sessions of every row, ordered by seed."""
    own = {} if spread is None else {"spread": spread}
    return [
        Job(
            name,
            f"seed-{seed}",
            session,
            {"seed": seed, "name": row.preset, "learner": row.learner, "retests": RETESTS, **own},
        )
        for seed in seeds
        for name, row in ((name, ROWS[name]) for name in rows)
    ]


def line(sessions: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Statistics of the sessions of a row.

    Returns:
        "sessions": their number; "near": those whose reproduction came down within NEAR;
        "solved": those with at least SOLVED re-tests in the cup; "confirmed": those that the
        stopping rule ended; "rollouts": median and quartiles of the number of rollouts,
        confirmation included, where a session without one counts with its budget.
    """
    caught = [
        sum(trial["caught"] for trial in each["trials"] if trial["kind"] == "retest")
        for each in sessions
    ]
    first = [each["trials"][0]["distance"] for each in sessions]
    return {
        "sessions": len(sessions),
        "near": sum(distance is not None and distance < NEAR for distance in first),
        "solved": sum(count >= SOLVED for count in caught),
        "confirmed": sum(each["confirmed"] for each in sessions),
        "rollouts": np.quantile([each["used"] for each in sessions], (0.5, 0.25, 0.75)).tolist(),
    }


def main() -> None:
    """Run the sessions of every row and print their statistics."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--folder", type=Path, default=Path("ball-in-cup"))
    parser.add_argument("--seeds", type=int, default=len(HELD_OUT), help="of each row, at most 20")
    parser.add_argument("--only", nargs="+", choices=ROWS, default=list(ROWS), metavar="ROW")
    parser.add_argument("--spread", type=float, help="of the demonstrations")
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    wanted = jobs(HELD_OUT[: args.seeds], args.only, args.spread)
    results = job_cache.run(wanted, args.folder, workers=args.workers)
    for name in args.only:
        found = line(list(results[name].values()))
        sys.stdout.write(f"{name} (learns from {ROWS[name].told}): {found}\n")


if __name__ == "__main__":
    main()
