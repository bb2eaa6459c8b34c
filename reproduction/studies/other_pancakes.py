# SPDX-License-Identifier: Apache-2.0
"""Flipping a pancake of another size: with the policy of a session, or taught afresh.

    python -m reproduction.studies.other_pancakes [--folder DIR] [--seeds N] [--workers N]

prints a row for each way to begin and each size.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from reproduction import jobs as job_cache
from reproduction.jobs import Job
from reproduction.studies import new_goals
from reproduction.studies.flip_sessions import NOVICE, stand_in, teach
from reproduction.studies.grounds import BUDGET, RETESTS, SOLVED
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.policy import Policy, with_id
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.frames import PANCAKE_RADIUS

HELD_OUT = range(34000, 34020)  # seeds not used for tuning
RADII = (0.075, 0.08, 0.10, 0.12)  # [m]; the session's own pancake has `PANCAKE_RADIUS`
WAYS = ("carried over", "demonstrated before", "taught afresh")


def practised(environment: Environment, policy: Policy, seed: int) -> Practice:
    """A finished session of the default preset that begins with a policy."""
    settings = preset("flip", budget=BUDGET, retests=RETESTS)
    practice = Practice(settings, {}, [policy], seed, environment)
    for _ in environment.practise(practice):
        pass
    return practice


def outcome(practice: Practice) -> dict[str, Any]:
    """See `new_goals.outcome`; of the re-tests the true flips count."""
    retests = [record.truth or {} for record in practice.records if record.kind == "retest"]
    flips = sum(bool(truth.get("true_flip")) for truth in retests)
    return {**new_goals.outcome(practice), "successes": flips}


def session(seed: int, radii: Sequence[float] = RADII) -> dict[str, Any]:
    """A session of a novice, and others with other pancakes by every way to begin."""
    environment = stand_in(seed)
    (shown,) = teach(environment, seed, 1, NOVICE)
    known = practised(environment, shown, seed)
    result: dict[str, Any] = {"origin": outcome(known)}
    for number, radius in enumerate(radii, start=1):
        again = 100 * seed + number
        for way in WAYS:
            there = stand_in(again, body_size=radius / PANCAKE_RADIUS)
            policy: Policy | None = shown
            if way == "carried over":
                policy = None if known.best is None else known.best.policy
            elif way == "taught afresh":
                (policy,) = teach(there, again, 1, NOVICE)
            begun = None if policy is None else practised(there, with_id(policy, "begun"), again)
            result[f"{way}, {radius}"] = None if begun is None else outcome(begun)
    return result


def rows(results: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Outcomes by way and radius, and those of all radii by way."""
    found = {key: [each[key] for each in results] for key in results[0]}
    for way in WAYS:
        found[way] = [one for key, ones in found.items() if key.startswith(way) for one in ones]
    return found


def main() -> None:
    """Run the sessions and print a line for each way to begin and each size."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--folder", type=Path, default=Path("other_pancakes"))
    parser.add_argument("--seeds", type=int, default=6, help="at most 20")
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    seeds = HELD_OUT[: args.seeds]
    wanted = [Job("pancakes", f"seed-{s}", session, {"seed": s}) for s in seeds]
    results = job_cache.run(wanted, args.folder, workers=args.workers)["pancakes"]
    for key, outcomes in rows(list(results.values())).items():
        sys.stdout.write(f"{key}: {new_goals.line(outcomes, SOLVED)}\n")


if __name__ == "__main__":
    main()
