# SPDX-License-Identifier: Apache-2.0
"""What the reaching study has to say: every word and figure is made of its results."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.stats import ranksums

from wam_power_ros.reporting import study_figures
from wam_power_ros.reporting.chapter import Chapter, Claim, Figure, Table

Results = Mapping[str, Mapping[str, Mapping[str, Any]]]
SYNTHETIC, TAUGHT = "reaching-synthetic", "reaching-taught"
EXECUTED, PRACTISED = "reaching-executed", "reaching-practised"
VARIANTS = ("full", "diagonal")
PAPER = {"full": 0.73, "diagonal": 0.61}  # after 100 rollouts, mean of 10 experiments
FIRST = 10  # runs, as many as the paper's
LEVEL = 0.73
GEOMETRY = (
    "demonstrations, obstacle and unit of length: a calibrated geometry, with decimetres in Eq. 4, "
    "the only unit that can give both figures"
)


def chapter(results: Results) -> Chapter:
    """The chapter of `reaching.jobs`.

    Args:
        results: Study -> key -> result; other studies are not looked at.
    """
    synthetic = {variant: _runs(results[SYNTHETIC], variant) for variant in VARIANTS}
    taught = {variant: _runs(results[TAUGHT], variant) for variant in VARIANTS}
    return Chapter(
        title="Reaching past an obstacle (Sec. III-A, Fig. 2)",
        text=[
            "Four demonstrations are fitted by two primitives; a sphere lies on their mean. A "
            "rollout that meets it stays where it is; the return is Eq. 4. PoWER (sigma 3, noise "
            "times 0.965 a rollout, as in the authors' scripts) learns full matrices or only their "
            "diagonals. The noise of each was chosen on 60 other seeds. "
            f"Left open by the paper: {GEOMETRY}.",
        ],
        parts=[_synthetic(synthetic), _taught(taught, results[EXECUTED], results[PRACTISED])],
    )


def _synthetic(runs: Mapping[str, Mapping[str, Any]]) -> Chapter:
    final = {variant: run["means"][:, -1] for variant, run in runs.items()}
    full, diagonal = final["full"], final["diagonal"]
    count, rollouts = runs["full"]["means"].shape
    p = float(ranksums(full, diagonal, alternative="greater").pvalue)
    apart = float(full.mean() - diagonal.mean())
    stuck = float(np.mean(runs["full"]["stuck"]))
    over = f"{count} runs, {rollouts} rollouts"
    claims = [
        Claim(
            f"Reaching, {variant} matrices: mean return of {min(FIRST, count)} experiments",
            f"{PAPER[variant]:.2f}",
            f"{values[:FIRST].mean():.3f}",
            f"all {count}: {values.mean():.3f}, sd {values.std(ddof=1):.3f}",
            over,
            None,
            GEOMETRY,
        )
        for variant, values in final.items()
    ]
    claims += [
        Claim(
            "Reaching, full matrices: median at least 0.74 and mean at least 0.72",
            "",
            f"median {np.median(full):.3f}, mean {full.mean():.3f}",
            f"sd {full.std(ddof=1):.3f}, {full.min():.2f} to {full.max():.2f}",
            over,
            bool(np.median(full) >= 0.74 and full.mean() >= 0.72),
        ),
        Claim(
            "Reaching: full better than diagonal by at least 0.03 (rank-sum p < 0.01)",
            f"{PAPER['full'] - PAPER['diagonal']:.2f}",
            f"{apart:.3f}",
            f"p = {p:.2g}, one-sided",
            over,
            apart >= 0.03 and p < 0.01,
        ),
        Claim(
            "Reaching, full matrices: at most 10 % of runs stuck at the obstacle",
            "",
            f"{stuck:.0%}",
            f"diagonal {np.mean(runs['diagonal']['stuck']):.0%}",
            over,
            stuck <= 0.1,
        ),
        _stretch(runs["full"]["means"], over),
    ]
    return Chapter(
        "Synthetic demonstrations",
        [
            f"The demonstration itself returns {runs['full']['start']:.3f}. After {rollouts} "
            f"rollouts the noise-free mean returns {full.mean():.3f} with full matrices and "
            f"{diagonal.mean():.3f} with diagonal ones ({count} runs each, p = {p:.2g})."
        ],
        claims,
        [_table(runs, f"{over} of each variant; returns of the noise-free mean")],
        [
            Figure.of(
                "reaching-curves",
                "Return of the noise-free mean over rollouts, median and quartiles, with the "
                "paper's figures after 100 rollouts (of its own, unknown geometry).",
                study_figures.learner_curves(
                    {variant: run["means"].tolist() for variant, run in runs.items()},
                    ylabel="return (Eq. 4)",
                    marks={f"paper, {name}": value for name, value in PAPER.items()},
                ),
            ),
            _paths("fig2-reaching", "What was learnt in the first ten runs of each variant.", runs),
        ],
    )


def _stretch(means: np.ndarray, over: str) -> Claim:
    reached = [_reached(curve) for curve in means]
    median = float(np.median([np.inf if at is None else at for at in reached]))
    final = float(means[:, -1].mean())
    return Claim(
        f"Reaching, full, PoWER, stretch: mean 0.77, and {LEVEL} in a median of 45 rollouts",
        "",
        f"mean {final:.3f}; {LEVEL} "
        + (f"in a median of {median:.0f}" if np.isfinite(median) else "not in half of the runs"),
        f"{sum(at is not None for at in reached)} of {len(reached)} runs reached it",
        over,
        final >= 0.77 and median <= 45,
    )


def _taught(
    runs: Mapping[str, Mapping[str, Any]],
    executed: Mapping[str, Any],
    practised: Mapping[str, Any],
) -> Chapter:
    full, diagonal = (runs[variant]["means"][:, -1] for variant in VARIANTS)
    p = float(ranksums(full, diagonal, alternative="greater").pvalue)
    count, rollouts = runs["full"]["means"].shape
    rows = []
    for variant in VARIANTS:
        one = executed[variant]
        rows.append(
            [
                variant,
                f"{1e3 * one['rms']:.1f} mm",
                f"{1e3 * one['largest']:.1f} mm",
                f"{1e3 * one['planned_clearance']:+.1f} mm",
                f"{1e3 * one['clearance']:+.1f} mm",
                f"{one['planned_return']:.3f}",
                f"{one['executed_return']:.3f}",
                one["fault"] or "none",
            ]
        )
    clear = sum(executed[variant]["clearance"] > 0.0 for variant in VARIANTS)
    return Chapter(
        "Taught on the arm, and executed by it",
        [
            "The same with the four demonstrations of bags/reach_*, shown to the simulated arm in "
            "gravity compensation. Learning tries policies on Eq. 1; the learnt one is then "
            "executed by the torque controller on the simulated arm, which follows Eq. 1 in closed "
            "loop, with friction, delay and filtered velocities. There is no sphere in its world: "
            f"{clear} of {len(VARIANTS)} executed paths stay clear of where it would be. The arm "
            "is compliant and does not do quite what Eq. 1 plans, so it practises as well: PoWER "
            "on the returns of executed paths.",
        ],
        [
            Claim(
                "Reaching taught on the arm: full against diagonal, mean return",
                "",
                f"{full.mean():.3f} against {diagonal.mean():.3f}",
                f"p = {p:.2g}, one-sided",
                f"{count} runs, {rollouts} rollouts",
            )
        ],
        [
            _table(runs, f"{count} runs, {rollouts} rollouts; returns of the noise-free mean"),
            Table(
                "The learnt policy on the arm: deviation of the executed path from the planned "
                "one, least distance to the sphere, return of both paths.",
                (
                    "variant",
                    "rms deviation",
                    "largest",
                    "planned clearance",
                    "executed clearance",
                    "planned return",
                    "executed return",
                    "fault",
                ),
                rows,
            ),
            _practice(practised),
        ],
        [
            Figure.of(
                "reaching-executed",
                "The learnt path as Eq. 1 plans it, and as the arm executed it.",
                study_figures.reaching(
                    {
                        variant: _panel(
                            runs[variant],
                            [],
                            np.array(executed[variant]["planned"]),
                            np.array(executed[variant]["executed"]),
                        )
                        for variant in VARIANTS
                    }
                ),
            )
        ],
    )


def _practice(runs: Mapping[str, Any]) -> Table:
    rows = []
    for variant in VARIANTS:
        some = [run for run in runs.values() if run["variant"] == variant]
        rows.append(
            [
                variant,
                f"{len(some)} of {len(some[0]['returns'])}",
                f"{np.mean([run['returns'][0] for run in some]):.3f}",
                f"{np.mean([run['return'] for run in some]):.3f}",
                " ".join(f"{1e3 * run['clearance']:+.0f}" for run in some) + " mm",
                f"{sum(run['faults'] for run in some)}",
            ]
        )
    return Table(
        "Practised on the arm: runs and rollouts, return of the first rollout and of the learnt "
        "policy, both executed, means over the runs; how far each learnt policy stays from the "
        "sphere; rollouts that the controller ended.",
        ("variant", "runs", "first", "learnt", "clearance", "faults"),
        rows,
    )


def _table(runs: Mapping[str, Mapping[str, Any]], caption: str) -> Table:
    rows = []
    for variant, run in runs.items():
        final = run["means"][:, -1]
        rows.append(
            [
                variant,
                f"{final.mean():.3f}",
                f"{np.median(final):.3f}",
                f"{final.std(ddof=1):.3f}",
                f"{np.mean(run['best']):.3f}",
                f"{np.mean(run['stuck']):.0%}",
            ]
        )
    head = ("matrices", "mean", "median", "sd", "best rollout, mean", "stuck")
    return Table(f"{caption}.", head, rows, [(0, 1)] if rows[0][1] >= rows[1][1] else [(1, 1)])


def _paths(name: str, caption: str, runs: Mapping[str, Mapping[str, Any]]) -> Figure:
    panels = {}
    for variant, run in runs.items():
        paths = [np.array(path) for path in run["paths"][:FIRST]]
        best = int(np.argmax(run["means"][:FIRST, -1]))
        panels[variant] = _panel(run, paths, paths[best])
    return Figure.of(
        name, f"{caption} The best of them is set off.", study_figures.reaching(panels)
    )


def _panel(
    run: Mapping[str, Any],
    rollouts: list[np.ndarray],
    learnt: np.ndarray,
    executed: np.ndarray | None = None,
) -> study_figures.Reaching:
    demonstrations = [np.array(path) for path in run["demonstrations"]]
    return study_figures.Reaching(
        demonstrations=demonstrations,
        rollouts=rollouts,
        learnt=learnt,
        obstacle=np.array(run["obstacle"]),
        radius=run["radius"],
        goal=np.mean([path[-1] for path in demonstrations], axis=0),
        executed=executed,
    )


def _reached(curve: np.ndarray) -> int | None:
    """Rollout after which a curve is first at LEVEL."""
    at = np.flatnonzero(curve >= LEVEL)
    return int(at[0]) + 1 if len(at) else None


def _runs(study: Mapping[str, Mapping[str, Any]], variant: str) -> dict[str, Any]:
    """The jobs of a variant put together."""
    parts = [part for part in study.values() if part["variant"] == variant]
    joined = dict(parts[0])
    for name in ("best", "stuck", "paths"):
        joined[name] = [value for part in parts for value in part[name]]
    joined["means"] = np.concatenate([np.array(part["means"]) for part in parts])
    return joined
