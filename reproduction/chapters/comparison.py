# SPDX-License-Identifier: Apache-2.0
"""Chapter of the comparison of learners, computed from its results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import ranksums

from reproduction import figures as study_figures
from reproduction.chapter import Chapter, Claim, Figure, Table
from reproduction.jobs import Results
from reproduction.studies.comparison import BASELINES, REFINED

TASKS = {
    "reaching": "Reaching (Eq. 4): return of the noise-free mean",
    "pancake": "Pancake (Eq. 5): mean return of noisy repeats of the final mean",
}
LEARNERS = {
    "power": "PoWER",
    "shaped": "PoWER, warm-up, rank, mirrored",
    "adaptive": "PoWER, adaptive variance",
    "pi2": "PI2-BB",
    "cma": "CMA-ES",
    "reinforce": "REINFORCE",
    "enac": "eNAC",
    "random": "random search",
    "screened": "screened PoWER (ours; given the model)",
}
OURS = "screened"


@dataclass(frozen=True, eq=False)
class Runs:
    """All runs of a learner on a task.

    Attributes:
        final: Return of the final mean of each run. Shape (runs,).
        returns: Returns of the rollouts. Shape (runs, rollouts).
    """

    final: np.ndarray
    returns: np.ndarray

    @classmethod
    def of(cls, results: list[Mapping[str, Any]]) -> Runs:
        """Join jobs, which have several seeds each on reaching and one each on the pancake."""
        final, returns = [], []
        for job in results:
            on_reaching = "final" in job
            final += job["final"] if on_reaching else [float(np.mean(job["repeats"]))]
            returns += job["returns"] if on_reaching else [job["returns"]]
        return cls(np.array(final), np.array(returns))

    @property
    def mean_returns(self) -> np.ndarray:
        """Mean return of all rollouts of each run. Shape (runs,)."""
        return self.returns.mean(axis=1)

    @property
    def best_so_far(self) -> np.ndarray:
        """Highest return up to each rollout. Shape (runs, rollouts)."""
        return np.maximum.accumulate(self.returns, axis=1)

    def needed(self, level: float) -> str:
        """Median number of rollouts until one returned at least `level`."""
        reached = self.best_so_far >= level
        first = np.where(reached.any(axis=1), reached.argmax(axis=1) + 1.0, np.inf)
        median = float(np.median(first))
        return f"{median:.0f}" if np.isfinite(median) else f"over {self.returns.shape[1]}"


def chapter(results: Results) -> Chapter:
    """Chapter of `comparison.jobs`; ignores results of other studies."""
    return Chapter(
        "Learners side by side",
        [
            "All learners have the same number of rollouts, start at the same demonstration and "
            "learn full matrices and attractors. Settings and exploration scales of each were "
            "chosen on other seeds: on reaching, two settings with twelve scales on 10 seeds, and "
            "the best of them on 60 more; on the pancake, little more than the better of two "
            "scales on 2 seeds. Screened PoWER draws candidates from PoWER's distribution and "
            "executes the one of highest predicted return. It draws fewer candidates with every "
            "rollout, so that the rollouts decide in the end. The model of reaching is the free "
            "path of Eq. 1, Eq. 4 and the places where rollouts were stopped; that of the pancake "
            "is the toss that Eq. 1 plans, in free flight, corrected by the returns. All learners "
            "receive the same returns, but only screened PoWER is given a model: the comparison "
            "shows the value of a model, not of a learner "
            "(reproduction/studies/equal_knowledge.py gives the model to all). Rollouts until a "
            "return was reached count single rollouts; the mean policy reaches it later.",
        ],
        parts=[_task(task, results[f"comparison-{task}"]) for task in TASKS],
    )


def _task(task: str, study: Mapping[str, Mapping[str, Any]]) -> Chapter:
    jobs: dict[str, list[Mapping[str, Any]]] = {}
    for key, job in study.items():
        jobs.setdefault(key.split("-")[0], []).append(job)
    runs = {name: Runs.of(some) for name, some in jobs.items()}
    ours, power = runs[OURS], runs["power"]
    level = float(np.median(power.final))
    over = "{} runs of {} rollouts".format(*ours.returns.shape)
    rows = []
    for name, some in runs.items():
        final = some.final
        means = (final.mean(), np.median(final), final.std(ddof=1), some.mean_returns.mean())
        p = (_p_greater(ours.final, final), _p_greater(ours.mean_returns, some.mean_returns))
        cells = [*(f"{value:.3f}" for value in means), some.needed(level)]
        cells += ["" if name == OURS else f"{value:.1g}" for value in p]
        rows.append([LEARNERS[name], str(len(final)), *cells])
    best = max(range(len(rows)), key=lambda row: float(rows[row][2]))
    measured = {
        "final policy": {name: some.final for name, some in runs.items()},
        "all rollouts while it learns": {name: some.mean_returns for name, some in runs.items()},
    }
    return Chapter(
        TASKS[task],
        [
            f"{over} unless the table says fewer. PoWER's median final policy returns "
            f"{level:.3f}; a rollout with at least that return took "
            f"{power.needed(level)} rollouts with PoWER and {ours.needed(level)} with ours "
            "(median)."
        ],
        [
            _ahead(name, returns, f"{TASKS[task]}; {what}", over)
            for name in REFINED
            if name in runs
            for what, returns in measured.items()
        ],
        [
            Table(
                f"{TASKS[task]}. Rollouts: until one returned {level:.3f}, median over runs. "
                "p: ours greater, rank-sum, one-sided, for the final policy and for all rollouts.",
                (
                    *("learner", "runs", "mean", "median", "sd", "mean of all rollouts"),
                    *("rollouts", "p final policy", "p all rollouts"),
                ),
                rows,
                [(best, 2)],
            )
        ],
        [
            Figure.of(
                f"learners-{task}",
                "Best return so far, median and quartiles over runs.",
                study_figures.learner_curves(
                    {LEARNERS[name]: some.best_so_far.tolist() for name, some in runs.items()},
                    ours=[LEARNERS[OURS]],
                    ylabel="best return so far",
                ),
            )
        ],
    )


def _ahead(name: str, returns: Mapping[str, np.ndarray], what: str, over: str) -> Claim:
    """Claim that a learner has higher returns than all BASELINES."""
    baselines = [baseline for baseline in BASELINES if baseline in returns]
    ours, others = returns[name], [returns[baseline] for baseline in baselines]
    p_values = [_p_greater(ours, values) for values in others]
    is_ahead = all(ours.mean() > values.mean() for values in others) and max(p_values) < 0.01
    names = ", ".join(LEARNERS[baseline] for baseline in baselines)
    against = f"{ours.mean():.3f} against {', '.join(f'{v.mean():.3f}' for v in others)}"
    spread = f"p = {', '.join(f'{p:.1g}' for p in p_values)}"
    claim = f"{LEARNERS[name]} ahead of {names}: {what} (rank-sum p < 0.01)"
    count = min(map(len, (ours, *others)))
    return Claim(claim, "", against, spread, over, is_ahead, runs=count)


def _p_greater(ours: np.ndarray, others: np.ndarray) -> float:
    return float(ranksums(ours, others, alternative="greater").pvalue)
