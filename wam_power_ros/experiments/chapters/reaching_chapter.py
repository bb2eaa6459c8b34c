# SPDX-License-Identifier: Apache-2.0
"""Chapter of the reaching study, computed from its results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import ranksums

from wam_power_ros.experiments.jobs import Results
from wam_power_ros.experiments.studies.reaching import SYNTHETIC
from wam_power_ros.experiments.studies.reaching_arm import EXECUTED, PRACTISED, TAUGHT
from wam_power_ros.experiments.studies.reaching_runs import VARIANTS
from wam_power_ros.regions import Region
from wam_power_ros.reporting import study_figures
from wam_power_ros.reporting.chapter import Chapter, Claim, Figure, Table
from wam_power_ros.tasks.reach import figures as reach_figures

PAPER_RETURNS = {"full": 0.73, "diagonal": 0.61}  # after 100 rollouts, mean of 10 experiments
PAPER_RUNS = 10
LEVEL = 0.73
RUN_FIELDS = ("means", "best", "stuck", "paths")  # fields of a job with one value per run
GEOMETRY = (
    "demonstrations, obstacle and unit of length: a calibrated geometry, with decimetres in Eq. 4, "
    "the only unit that can give both figures"
)


@dataclass(frozen=True, eq=False)
class Runs:
    """All runs of one variant on one scenario.

    Attributes:
        means: Return of the noise-free mean after each rollout. Shape (runs, rollouts).
        best: Highest return of a rollout of each run.
        stuck: Whether the last mean of each run meets the obstacle.
        paths: Path of the last mean of each run [m]. Shapes (T, 3).
        start: Return of the demonstration.
        panel: Demonstrations and obstacle for the figure of the paths.
    """

    means: np.ndarray
    best: Sequence[float]
    stuck: Sequence[bool]
    paths: Sequence[np.ndarray]
    start: float
    panel: reach_figures.Panel

    @classmethod
    def of(cls, study: Mapping[str, Mapping[str, Any]], variant: str) -> Runs:
        """Join the jobs of a variant."""
        parts = [part for part in study.values() if part["variant"] == variant]
        joined = ([value for part in parts for value in part[name]] for name in RUN_FIELDS)
        means, best, stuck, paths = joined
        first = parts[0]
        shown = [np.array(path) for path in first["demonstrations"]]
        obstacle = Region("obstacle", tuple(first["obstacle"]), first["radius"])
        panel = reach_figures.Panel(shown, obstacle)
        arrays = [np.array(path) for path in paths]
        return cls(np.array(means), best, stuck, arrays, first["start"], panel)

    @property
    def final(self) -> np.ndarray:
        """Return of the last mean of each run. Shape (runs,)."""
        return self.means[:, -1]

    @property
    def over(self) -> str:
        """Number of runs and rollouts."""
        return "{} runs, {} rollouts".format(*self.means.shape)


def chapter(results: Results) -> Chapter:
    """Chapter of `reaching.jobs`; ignores results of other studies."""
    synthetic, taught = (
        {variant: Runs.of(results[study], variant) for variant in VARIANTS}
        for study in (SYNTHETIC, TAUGHT)
    )
    return Chapter(
        "Reaching past an obstacle (Sec. III-A, Fig. 2)",
        [
            "Two primitives are fitted to four demonstrations; a sphere lies on their mean. A "
            "rollout that touches it stops there; the return is Eq. 4. PoWER (sigma 3, noise times "
            "0.965 after each rollout, as in the authors' scripts) learns full matrices or only "
            "their diagonals. The noise of each was chosen on 60 other seeds. "
            f"Left open by the paper: {GEOMETRY}.",
        ],
        parts=[_synthetic(synthetic), _taught(taught, results[EXECUTED], results[PRACTISED])],
    )


def _synthetic(runs: Mapping[str, Runs]) -> Chapter:
    full, diagonal = (runs[variant].final for variant in VARIANTS)
    over = runs["full"].over
    count, rollouts = runs["full"].means.shape
    p = _p_greater(full, diagonal)
    difference = float(full.mean() - diagonal.mean())
    stuck = float(np.mean(runs["full"].stuck))
    hit = runs["full"].means >= LEVEL  # (runs, rollouts)
    needed = float(np.median(np.where(hit.any(axis=1), hit.argmax(axis=1) + 1.0, np.inf)))
    reached = f"in a median of {needed:.0f}" if np.isfinite(needed) else "not in half of the runs"
    claim = partial(Claim, count=over)
    claims = [
        claim(
            f"Reaching, {variant} matrices: mean return of {min(PAPER_RUNS, count)} experiments",
            f"{PAPER_RETURNS[variant]:.2f}",
            f"{final[:PAPER_RUNS].mean():.3f}",
            f"all {count}: {final.mean():.3f}, sd {final.std(ddof=1):.3f}",
            left_open=GEOMETRY,
        )
        for variant, final in (("full", full), ("diagonal", diagonal))
    ]
    judged = partial(claim, runs=count)
    claims += [
        judged(
            "Reaching, full matrices: median at least 0.74 and mean at least 0.72",
            "",
            f"median {np.median(full):.3f}, mean {full.mean():.3f}",
            f"sd {full.std(ddof=1):.3f}, {full.min():.2f} to {full.max():.2f}",
            met=bool(np.median(full) >= 0.74 and full.mean() >= 0.72),
        ),
        judged(
            "Reaching: full better than diagonal by at least 0.03 (rank-sum p < 0.01)",
            f"{PAPER_RETURNS['full'] - PAPER_RETURNS['diagonal']:.2f}",
            f"{difference:.3f}",
            f"p = {p:.2g}, one-sided",
            met=difference >= 0.03 and p < 0.01,
        ),
        judged(
            "Reaching, full matrices: at most 10 % of runs stuck at the obstacle",
            "",
            f"{stuck:.0%}",
            f"diagonal {np.mean(runs['diagonal'].stuck):.0%}",
            met=stuck <= 0.1,
        ),
        judged(
            f"Reaching, full, PoWER, stretch: mean 0.77, and {LEVEL} in a median of 45 rollouts",
            "",
            f"mean {full.mean():.3f}; {LEVEL} {reached}",
            f"{hit.any(axis=1).sum()} of {count} runs reached it",
            met=bool(full.mean() >= 0.77 and needed <= 45),
        ),
    ]
    learnt = {}
    for variant, some in runs.items():
        best = some.paths[int(np.argmax(some.final[:PAPER_RUNS]))]
        learnt[variant] = replace(some.panel, learnt=best, rollouts=some.paths[:PAPER_RUNS])
    return Chapter(
        "Synthetic demonstrations",
        [
            f"The demonstration returns {runs['full'].start:.3f}. After {rollouts} "
            f"rollouts the noise-free mean returns {full.mean():.3f} with full matrices and "
            f"{diagonal.mean():.3f} with diagonal ones ({count} runs each, p = {p:.2g})."
        ],
        claims,
        [_table(runs, f"{over} of each variant; returns of the noise-free mean.")],
        [
            Figure.of(
                "reaching-curves",
                "Return of the noise-free mean over rollouts, median and quartiles, with the "
                "paper's values after 100 rollouts (in its own, unknown geometry).",
                study_figures.learner_curves(
                    {variant: some.means.tolist() for variant, some in runs.items()},
                    ylabel="return (Eq. 4)",
                    marks={f"paper, {name}": value for name, value in PAPER_RETURNS.items()},
                ),
            ),
            Figure.of(
                "fig2-reaching",
                "Paths learnt in the first ten runs of each variant, the best highlighted.",
                reach_figures.paths(learnt),
            ),
        ],
    )


def _taught(
    runs: Mapping[str, Runs], executed: Mapping[str, Any], practised: Mapping[str, Any]
) -> Chapter:
    full, diagonal = (runs[variant].final for variant in VARIANTS)
    over = runs["full"].over
    rows, panels = [], {}
    for variant in VARIANTS:
        one = executed[variant]
        lengths = (f"{1e3 * one[name]:.1f} mm" for name in ("rms", "largest"))
        clearances = (f"{1e3 * one[name]:+.1f} mm" for name in ("planned_clearance", "clearance"))
        returns = (f"{one[name]:.3f}" for name in ("planned_return", "executed_return"))
        rows.append([variant, *lengths, *clearances, *returns, one["fault"] or "none"])
        planned, path = np.array(one["planned"]), np.array(one["executed"])
        panels[variant] = replace(runs[variant].panel, learnt=planned, executed=path)
    clear = sum(executed[variant]["clearance"] > 0.0 for variant in VARIANTS)
    distances = ("rms deviation", "largest", "planned clearance", "executed clearance")
    return Chapter(
        "Taught on the arm, and executed by it",
        [
            "The same with the four demonstrations of bags/reach_*, recorded on the simulated arm "
            "under gravity compensation. Learning simulates Eq. 1; the torque controller then "
            "executes the learnt policy on the simulated arm, following Eq. 1 in closed loop, with "
            "friction, delay and filtered velocities. The simulated world has no sphere: "
            f"{clear} of {len(VARIANTS)} executed paths stay clear of its place. The arm is "
            "compliant and deviates from the plan of Eq. 1, so PoWER also practises on the arm, "
            "with the returns of executed paths.",
        ],
        [
            Claim(
                "Reaching taught on the arm: full against diagonal, mean return",
                "",
                f"{full.mean():.3f} against {diagonal.mean():.3f}",
                f"p = {_p_greater(full, diagonal):.2g}, one-sided",
                over,
            )
        ],
        [
            _table(runs, f"{over}; returns of the noise-free mean."),
            Table(
                "The learnt policy on the arm: deviation of the executed path from the planned "
                "path, smallest distance to the sphere, return of both paths.",
                ("variant", *distances, "planned return", "executed return", "fault"),
                rows,
            ),
            _practice(practised),
        ],
        [
            Figure.of(
                "reaching-executed",
                "The learnt path as Eq. 1 plans it, and as the arm executed it.",
                reach_figures.paths(panels),
            )
        ],
    )


def _practice(runs: Mapping[str, Any]) -> Table:
    rows = []
    for variant in VARIANTS:
        some = [run for run in runs.values() if run["variant"] == variant]
        first = np.mean([run["returns"][0] for run in some])
        learnt = np.mean([run["return"] for run in some])
        clearances = " ".join(f"{1e3 * run['clearance']:+.0f}" for run in some) + " mm"
        cells = [f"{len(some)} of {len(some[0]['returns'])}", f"{first:.3f}", f"{learnt:.3f}"]
        rows.append([variant, *cells, clearances, f"{sum(run['faults'] for run in some)}"])
    return Table(
        "Practised on the arm: runs and rollouts, return of the first rollout and of the learnt "
        "policy, both executed, means over the runs; distance of each learnt policy from the "
        "sphere; rollouts that the controller ended.",
        ("variant", "runs", "first", "learnt", "clearance", "faults"),
        rows,
    )


def _table(runs: Mapping[str, Runs], caption: str) -> Table:
    rows = []
    for variant, some in runs.items():
        final = some.final
        returns = (final.mean(), np.median(final), final.std(ddof=1), np.mean(some.best))
        rows.append([variant, *(f"{value:.3f}" for value in returns), f"{np.mean(some.stuck):.0%}"])
    head = ("matrices", "mean", "median", "sd", "best rollout, mean", "stuck")
    return Table(caption, head, rows, [(0, 1)] if rows[0][1] >= rows[1][1] else [(1, 1)])


def _p_greater(one: np.ndarray, other: np.ndarray) -> float:
    return float(ranksums(one, other, alternative="greater").pvalue)
