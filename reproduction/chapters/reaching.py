# SPDX-License-Identifier: Apache-2.0
"""Statistics, tables and figures of the reaching study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import ranksums

from reproduction import figures, reach_paths
from reproduction.chapter import Study
from reproduction.jobs import Results
from reproduction.studies import reaching
from reproduction.studies.reaching import SYNTHETIC, VARIANTS
from reproduction.studies.reaching_scenario import RADIUS, synthetic
from wam_power_ros.regions import Region

PAPER_RETURNS = {"full": 0.73, "diagonal": 0.61}  # after 100 rollouts, mean of 10 experiments
PAPER_RUNS = 10
LEVEL = 0.73


@dataclass(frozen=True, eq=False)
class Runs:
    """All runs of one variant."""

    means: np.ndarray  # return of the noise-free mean after each rollout, shape (runs, rollouts)
    best: Sequence[float]  # highest return of a rollout of each run
    stuck: Sequence[bool]  # whether the last mean of each run meets the obstacle
    paths: Sequence[np.ndarray]  # of the last mean of each run [m], shapes (T, 3)

    @classmethod
    def from_study(cls, study: Mapping[str, Mapping[str, Any]], variant: str) -> Runs:
        """Join the jobs of a variant."""
        parts = [part for part in study.values() if part["variant"] == variant]
        names = ("means", "best", "stuck", "paths")
        means, best, stuck, paths = ([one for part in parts for one in part[n]] for n in names)
        return cls(np.array(means), best, stuck, [np.array(path) for path in paths])

    @property
    def final(self) -> np.ndarray:
        """Return of the last mean of each run. Shape (runs,)."""
        return self.means[:, -1]

    @property
    def stuck_share(self) -> float:
        """Share of the runs whose last mean meets the obstacle."""
        return float(np.mean(self.stuck))

    @property
    def reached(self) -> int:
        """Number of runs whose mean returned `LEVEL`."""
        return int((self.means >= LEVEL).any(axis=1).sum())

    @property
    def needed(self) -> float:
        """Median number of rollouts until the mean returned `LEVEL`, infinite for half the runs."""
        hit = self.means >= LEVEL
        return float(np.median(np.where(hit.any(axis=1), hit.argmax(axis=1) + 1.0, np.inf)))

    @property
    def over(self) -> str:
        """Number of runs and rollouts."""
        return "{} runs, {} rollouts".format(*self.means.shape)


def values(results: Results) -> dict[str, Any]:
    """Names of the template; ignores results of other studies."""
    runs, scenario = {v: Runs.from_study(results[SYNTHETIC], v) for v in VARIANTS}, synthetic()
    obstacle = Region("obstacle", tuple(scenario.obstacle.tolist()), RADIUS)
    learnt = {}
    for variant, some in runs.items():
        best = some.paths[int(np.argmax(some.final[:PAPER_RUNS]))]
        rollouts = some.paths[:PAPER_RUNS]
        learnt[variant] = reach_paths.Panel(scenario.demonstrations, obstacle, best, rollouts)
    full, diagonal = (runs[variant].final for variant in VARIANTS)
    return {
        "runs": runs,
        "start": scenario.demonstrated_return,
        "p_value": float(ranksums(full, diagonal, alternative="greater").pvalue),
        "rows": _rows(runs),
        "paper": PAPER_RETURNS,
        "paper_runs": PAPER_RUNS,
        "level": LEVEL,
        "curves": figures.learner_curves(
            {variant: some.means.tolist() for variant, some in runs.items()},
            ylabel="return (Eq. 4)",
            marks={f"paper, {name}": value for name, value in PAPER_RETURNS.items()},
        ),
        "learnt": reach_paths.paths(learnt),
    }


def _rows(runs: Mapping[str, Runs]) -> list[list[str]]:
    rows = []
    for variant, some in runs.items():
        final = some.final
        returns = (final.mean(), np.median(final), final.std(ddof=1), np.mean(some.best))
        rows.append([variant, *(f"{value:.3f}" for value in returns), f"{some.stuck_share:.0%}"])
    return rows


STUDY = Study(
    "Reaching past an obstacle (Sec. III-A, Fig. 2)",
    reaching.jobs,
    values,
    Path(__file__).with_suffix(".html.j2"),
)
