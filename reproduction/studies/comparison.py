# SPDX-License-Identifier: Apache-2.0
"""Learners side by side on both tasks: equal rollouts, equal tuning, held-out seeds.

    python -m reproduction.studies.comparison pancake [pi2]

tunes one learner or all of them on a task: all settings in GRID with all exploration scales in
NOISE on a few tuning seeds, then the best of these on more seeds. The best choices are printed;
TUNED is then edited by hand.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from reproduction import jobs as job_cache
from reproduction.jobs import Job, Scale
from reproduction.studies.comparison_runs import pancake_run, reaching_runs

BASELINES = ("power", "cma", "pi2")  # learners from the literature that claims compare with
REFINED = ("screened", "shaped")  # learners with a claim: ours, and PoWER refined


class Choice(NamedTuple):
    """Settings of a learner as data, and the standard deviations of its exploration."""

    settings: dict[str, Any]
    stiffness: float  # fraction of the mean stiffness
    attractor: float  # [m]


class Effort(NamedTuple):
    """Tuning seeds of a learner: `few` for all choices; `many` for the best `kept`, if any."""

    few: Sequence[int]
    many: Sequence[int]
    kept: int


ROLLOUTS = {"reaching": 100, "pancake": 40}
# Seeds 401-440 were used to decide what to measure; claims are measured on others.
HELD_OUT = {"reaching": range(441, 481), "pancake": range(417, 433)}
UNCLAIMED_SEEDS = 8  # of a learner without a claim on the pancake, where a run takes 15 s
EFFORT = {
    "reaching": Effort(range(1_000_000, 1_000_010), range(1_000_010, 1_000_070), 4),
    "pancake": Effort(range(21, 23), range(0), 0),
}
NOISE = {
    "reaching": [(k, mu) for k in (0.3, 0.6, 1.0) for mu in (0.00625, 0.0125, 0.025, 0.05)],
    "pancake": [(0.1, 0.01), (0.2, 0.02)],
}
# Two settings of each learner that its literature suggests for some tens of rollouts.
GRID: dict[str, list[dict[str, Any]]] = {
    "power": [{"sigma": 3, "decay": 0.965}, {"sigma": 6, "decay": 1.0}],
    "shaped": [{"kind": "shaped_power", "sigma": sigma} for sigma in (3, 6)],
    "adaptive": [{"kind": "adaptive_power", "sigma": sigma} for sigma in (3, 10)],
    "pi2": [{"kind": "pi2_bb", "population": count, "decay": 0.9} for count in (5, 10)],
    "cma": [{"kind": "cma_es", "population": population} for population in (6, 12)],
    "reinforce": [{"kind": "reinforce", "population": 10, "rate": rate} for rate in (0.5, 2.0)],
    "enac": [{"kind": "enac", "population": 10, "rate": rate} for rate in (0.5, 2.0)],
    "random": [{"kind": "random"}],
    "screened": [{"kind": "screened", "half_life": half_life} for half_life in (4, 16)],
}
# Best choices found by `tune`: on reaching, among all of GRID and NOISE; on the pancake, only
# among the two of NOISE, for one setting of each learner (both of PoWER and ours).
TUNED: dict[str, dict[str, Choice]] = {
    "reaching": {
        "power": Choice(GRID["power"][0], 0.6, 0.00625),
        "shaped": Choice(GRID["shaped"][1], 0.6, 0.0125),
        "adaptive": Choice(GRID["adaptive"][0], 0.6, 0.0125),
        "pi2": Choice(GRID["pi2"][1], 0.3, 0.00625),
        "cma": Choice(GRID["cma"][0], 0.3, 0.00625),
        "reinforce": Choice(GRID["reinforce"][1], 0.3, 0.00625),
        "enac": Choice(GRID["enac"][1], 0.6, 0.0125),
        "random": Choice(GRID["random"][0], 0.3, 0.00625),
        "screened": Choice(GRID["screened"][1], 0.6, 0.00625),
    },
    "pancake": {
        "power": Choice(GRID["power"][1], 0.2, 0.02),
        "shaped": Choice(GRID["shaped"][0], 0.2, 0.02),
        "adaptive": Choice(GRID["adaptive"][0], 0.1, 0.01),
        "pi2": Choice(GRID["pi2"][0], 0.1, 0.01),
        "cma": Choice(GRID["cma"][0], 0.2, 0.02),
        "reinforce": Choice(GRID["reinforce"][1], 0.2, 0.02),
        "enac": Choice(GRID["enac"][1], 0.2, 0.02),
        "random": Choice(GRID["random"][0], 0.2, 0.02),
        "screened": Choice(GRID["screened"][0], 0.1, 0.01),
    },
}
CHUNK = 10  # reaching runs per job


def jobs(scale: Scale) -> list[Job]:
    """Held-out runs of every learner on both tasks; in "quick", few short ones on tuning seeds."""
    found = []
    for task in ROLLOUTS:
        seeds = HELD_OUT[task] if scale == "full" else EFFORT[task].few[:2]
        rollouts = ROLLOUTS[task] if scale == "full" else 3
        for name in GRID if scale == "full" else ("power", "cma", "pi2", "screened"):
            unclaimed = task == "pancake" and name not in (*BASELINES, *REFINED)
            some = seeds[:UNCLAIMED_SEEDS] if unclaimed else seeds
            found += _runs(task, f"comparison-{task}", name, TUNED[task][name], some, rollouts)
    return found


def tune(task: str, name: str) -> list[tuple[float, Choice]]:
    """Choices for a learner with their mean final return on the last seeds, best first.

    Results in the folder `tuning` are not computed again.
    """
    effort = EFFORT[task]
    final = "final" if task == "reaching" else "repeats"

    def ranked(choices: Sequence[Choice], seeds: Sequence[int]) -> list[tuple[float, Choice]]:
        wanted = {f"tune-{task}-{name}-{seeds[0]}-{k}": some for k, some in enumerate(choices)}
        jobs = [
            job
            for study, choice in wanted.items()
            for job in _runs(task, study, name, choice, seeds, ROLLOUTS[task])
        ]
        results = job_cache.run(jobs, Path("tuning"), workers=2)
        scores = [np.mean([run[final] for run in results[study].values()]) for study in wanted]
        return sorted(zip(map(float, scores), choices, strict=True), key=lambda score: -score[0])

    choices = [Choice(settings, *noise) for settings in GRID[name] for noise in NOISE[task]]
    scored = ranked(choices, effort.few)
    if not effort.kept:
        return scored
    return ranked([choice for _, choice in scored[: effort.kept]], effort.many)


def _runs(
    task: str, study: str, name: str, choice: Choice, seeds: Sequence[int], rollouts: int
) -> list[Job]:
    common = {**choice._asdict(), "rollouts": rollouts}
    if task == "pancake":
        return [Job(study, f"{name}-{k}", pancake_run, {**common, "seed": k}) for k in seeds]
    chunks = [list(seeds[k : k + CHUNK]) for k in range(0, len(seeds), CHUNK)]
    return [
        Job(study, f"{name}-{chunk[0]}-{chunk[-1]}", reaching_runs, {**common, "seeds": chunk})
        for chunk in chunks
    ]


def main() -> None:
    """Tune learners and print the scores."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("task", choices=ROLLOUTS)
    parser.add_argument("learner", choices=GRID, nargs="?", help="tune only this learner")
    args = parser.parse_args()
    for name in [args.learner] if args.learner else GRID:
        for score, choice in tune(args.task, name):
            sys.stdout.write(f"{name:10} {score:.3f} {choice}\n")


if __name__ == "__main__":
    main()
