# SPDX-License-Identifier: Apache-2.0
"""Statistics, tables and figures of the comparison of learners."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import ranksums

from reproduction import figures
from reproduction.chapter import Study
from reproduction.jobs import Results
from reproduction.studies import comparison
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


def values(results: Results) -> dict[str, Any]:
    """Names of the template; ignores results of other studies."""
    return {"tasks": [_task(name, results[f"comparison-{name}"]) for name in TASKS]}


def _task(task: str, study: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Names of the section of a task."""
    jobs: dict[str, list[Mapping[str, Any]]] = {}
    for key, job in study.items():
        jobs.setdefault(key.split("-")[0], []).append(job)
    runs = {name: Runs.of(some) for name, some in jobs.items()}
    ours, level = runs[OURS], float(np.median(runs["power"].final))
    rows = []
    for name, some in runs.items():
        final = some.final
        means = (final.mean(), np.median(final), final.std(ddof=1), some.mean_returns.mean())
        p = (_p_greater(ours.final, final), _p_greater(ours.mean_returns, some.mean_returns))
        cells = [*(f"{value:.3f}" for value in means), some.needed(level)]
        cells += ["" if name == OURS else f"{value:.1g}" for value in p]
        rows.append([LEARNERS[name], str(len(final)), *cells])
    measured = {
        "final policy": {name: some.final for name, some in runs.items()},
        "all rollouts while it learns": {name: some.mean_returns for name, some in runs.items()},
    }
    curves = {LEARNERS[name]: some.best_so_far.tolist() for name, some in runs.items()}
    return {
        "name": task,
        "title": TASKS[task],
        "over": "{} runs of {} rollouts".format(*ours.returns.shape),
        "level": level,
        "needed": [runs[name].needed(level) for name in ("power", OURS)],
        "claims": [
            {"what": what, **_ahead(name, returns)}
            for name in REFINED
            if name in runs
            for what, returns in measured.items()
        ],
        "rows": rows,
        "best": max(range(len(rows)), key=lambda row: float(rows[row][2])),
        "curves": figures.learner_curves(
            curves, ours=[LEARNERS[OURS]], ylabel="best return so far"
        ),
    }


def _ahead(name: str, returns: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Whether a learner has higher returns than all BASELINES."""
    others = {other: returns[other] for other in BASELINES if other in returns}
    ours, p_values = returns[name], [_p_greater(returns[name], some) for some in others.values()]
    ahead = all(ours.mean() > some.mean() for some in others.values())
    return {
        "learner": LEARNERS[name],
        "others": ", ".join(LEARNERS[other] for other in others),
        "mean": ours.mean(),
        "means": ", ".join(f"{some.mean():.3f}" for some in others.values()),
        "p": ", ".join(f"{p:.1g}" for p in p_values),
        "met": ahead and max(p_values) < 0.01,
        "runs": min(map(len, (ours, *others.values()))),
    }


def _p_greater(ours: np.ndarray, others: np.ndarray) -> float:
    return float(ranksums(ours, others, alternative="greater").pvalue)


STUDY = Study(
    "Learners side by side", comparison.jobs, values, Path(__file__).with_suffix(".html.j2")
)
