# SPDX-License-Identifier: Apache-2.0
"""Statistics, tables and figures of the reaching study."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import ranksums

from reproduction import figures, reach_paths
from reproduction.chapter import Study
from reproduction.jobs import Results
from reproduction.studies import reaching
from reproduction.studies.reaching import SYNTHETIC
from reproduction.studies.reaching_arm import EXECUTED, TAUGHT
from reproduction.studies.reaching_runs import VARIANTS
from wam_power_ros.regions import Region

PAPER_RETURNS = {"full": 0.73, "diagonal": 0.61}  # after 100 rollouts, mean of 10 experiments
PAPER_RUNS = 10
LEVEL = 0.73
RUN_FIELDS = ("means", "best", "stuck", "paths")  # fields of a job with one value per run


@dataclass(frozen=True, eq=False)
class Runs:
    """All runs of one variant on one scenario.

    Attributes:
        means: Return of the noise-free mean after each rollout. Shape (runs, rollouts).
        best: Highest return of a rollout of each run.
        stuck: Whether the last mean of each run meets the obstacle.
        paths: Path of the last mean of each run [m]. Shapes (T, 3).
        start: Return of the demonstration.
        panel: Makes a panel of the figure of paths, from others than demonstrations and obstacle.
    """

    means: np.ndarray
    best: Sequence[float]
    stuck: Sequence[bool]
    paths: Sequence[np.ndarray]
    start: float
    panel: Callable[..., reach_paths.Panel]

    @classmethod
    def of(cls, study: Mapping[str, Mapping[str, Any]], variant: str) -> Runs:
        """Join the jobs of a variant."""
        parts = [part for part in study.values() if part["variant"] == variant]
        joined = ([value for part in parts for value in part[name]] for name in RUN_FIELDS)
        means, best, stuck, paths = joined
        first = parts[0]
        shown = [np.array(path) for path in first["demonstrations"]]
        obstacle = Region("obstacle", tuple(first["obstacle"]), first["radius"])
        panel = partial(reach_paths.Panel, shown, obstacle)
        arrays = [np.array(path) for path in paths]
        return cls(np.array(means), best, stuck, arrays, first["start"], panel)

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
    synthetic, taught = (
        {variant: Runs.of(results[study], variant) for variant in VARIANTS}
        for study in (SYNTHETIC, TAUGHT)
    )
    learnt, carried_out = {}, {}
    for variant in VARIANTS:
        some, one = synthetic[variant], results[EXECUTED][variant]
        best = some.paths[int(np.argmax(some.final[:PAPER_RUNS]))]
        learnt[variant] = some.panel(learnt=best, rollouts=some.paths[:PAPER_RUNS])
        planned, path = np.array(one["planned"]), np.array(one["executed"])
        carried_out[variant] = taught[variant].panel(learnt=planned, executed=path)
    return {
        "synthetic": synthetic,
        "taught": taught,
        "executed": results[EXECUTED],
        "p": {name: _p(some) for name, some in (("synthetic", synthetic), ("taught", taught))},
        "rows": {
            name: _rows(runs) for name, runs in (("synthetic", synthetic), ("taught", taught))
        },
        "paper": PAPER_RETURNS,
        "paper_runs": PAPER_RUNS,
        "level": LEVEL,
        "curves": figures.learner_curves(
            {variant: some.means.tolist() for variant, some in synthetic.items()},
            ylabel="return (Eq. 4)",
            marks={f"paper, {name}": value for name, value in PAPER_RETURNS.items()},
        ),
        "learnt": reach_paths.paths(learnt),
        "carried_out": reach_paths.paths(carried_out),
    }


def _rows(runs: Mapping[str, Runs]) -> list[list[str]]:
    rows = []
    for variant, some in runs.items():
        final = some.final
        returns = (final.mean(), np.median(final), final.std(ddof=1), np.mean(some.best))
        rows.append([variant, *(f"{value:.3f}" for value in returns), f"{some.stuck_share:.0%}"])
    return rows


def _p(runs: Mapping[str, Runs]) -> float:
    full, diagonal = (runs[variant].final for variant in VARIANTS)
    return float(ranksums(full, diagonal, alternative="greater").pvalue)


STUDY = Study(
    "Reaching past an obstacle (Sec. III-A, Fig. 2)",
    reaching.jobs,
    values,
    Path(__file__).with_suffix(".html.j2"),
)
