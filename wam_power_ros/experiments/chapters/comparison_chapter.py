# SPDX-License-Identifier: Apache-2.0
"""What the comparison of learners has to say: every word and figure is made of its results."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.stats import ranksums

from wam_power_ros.reporting import study_figures
from wam_power_ros.reporting.chapter import Chapter, Claim, Figure, Table

Results = Mapping[str, Mapping[str, Mapping[str, Any]]]
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
    "screened": "screened PoWER (ours)",
}
OURS = "screened"
NOT_THE_PAPERS = (OURS, "shaped")  # ours and PoWER refined, each against the foils
FOILS = ("power", "cma", "pi2")


def chapter(results: Results) -> Chapter:
    """The chapter of `comparison.jobs`.

    Args:
        results: Study -> key -> result; other studies are not looked at.
    """
    return Chapter(
        title="Learners side by side",
        text=[
            "All learners have the same rollouts, start at the same demonstration and learn full "
            "matrices and attractors. Settings and exploration of each were chosen on other seeds: "
            "on reaching two settings with twelve explorations, on 10 seeds and the best of them "
            "on 60 more; on the pancake little more than the better of two explorations, on 2 "
            "seeds. Screened PoWER draws candidates from PoWER's own distribution and tries the "
            "one a model promises most of; of ever fewer candidates, so that the rollouts have the "
            "last word. The model of reaching is Eq. 1's free path and Eq. 4, and the places where "
            "rollouts were stopped; that of the pancake is the toss Eq. 1 plans, flying freely, "
            "put right by the returns. It is told no more than the others are, but it is given "
            "these models, which the others are not.",
        ],
        parts=[_task(task, results[f"comparison-{task}"]) for task in TASKS],
    )


def _task(task: str, study: Mapping[str, Mapping[str, Any]]) -> Chapter:
    final, returns = _gather(study)
    rollouts = next(iter(returns.values())).shape[1]
    curves = {name: np.maximum.accumulate(runs, axis=1) for name, runs in returns.items()}
    practised = {name: runs.mean(axis=1) for name, runs in returns.items()}
    ours = final[OURS]
    level = float(np.median(final["power"]))
    rows = []
    for name, values in final.items():
        rows.append(
            [
                LEARNERS[name],
                str(len(values)),
                f"{values.mean():.3f}",
                f"{np.median(values):.3f}",
                f"{values.std(ddof=1):.3f}",
                f"{practised[name].mean():.3f}",
                _needed(curves[name], level),
                "" if name == OURS else f"{_p_greater(ours, values):.1g}",
                "" if name == OURS else f"{_p_greater(practised[OURS], practised[name]):.1g}",
            ]
        )
    best = max(range(len(rows)), key=lambda row: float(rows[row][2]))
    over = f"{len(ours)} runs of {rollouts} rollouts"
    return Chapter(
        TASKS[task],
        [
            f"{over} where the table does not say fewer. PoWER's median answer returns "
            f"{level:.3f}; a rollout of that return came after "
            f"{_needed(curves['power'], level)} rollouts with PoWER and "
            f"{_needed(curves[OURS], level)} with ours (median)."
        ],
        [
            _ahead(name, measured, f"{TASKS[task]}; {what}", over)
            for name in NOT_THE_PAPERS
            if name in final
            for what, measured in (
                ("its answer", final),
                ("its rollouts, all while it learns", practised),
            )
        ],
        [
            Table(
                f"{TASKS[task]}. Rollouts: until one returned {level:.3f}, median over runs. "
                "p: ours greater, rank-sum, one-sided, of the answer and of all rollouts.",
                (
                    "learner",
                    "runs",
                    "mean",
                    "median",
                    "sd",
                    "mean of all rollouts",
                    "rollouts",
                    "p answer",
                    "p rollouts",
                ),
                rows,
                [(best, 2)],
            )
        ],
        [
            Figure.of(
                f"learners-{task}",
                "Best return so far, median over runs; ours with its quartiles.",
                study_figures.learner_curves(
                    {LEARNERS[name]: runs.tolist() for name, runs in curves.items()},
                    ours=[LEARNERS[OURS]],
                    ylabel="best return so far",
                ),
            )
        ],
    )


def _ahead(name: str, measured: Mapping[str, np.ndarray], what: str, over: str) -> Claim:
    ours, others = measured[name], {foil: measured[foil] for foil in FOILS if foil in measured}
    p_values = [_p_greater(ours, values) for values in others.values()]
    ahead = all(ours.mean() > values.mean() for values in others.values())
    return Claim(
        f"{LEARNERS[name]} ahead of {', '.join(LEARNERS[foil] for foil in others)}: {what} "
        "(rank-sum p < 0.01)",
        "",
        f"{ours.mean():.3f} against "
        + ", ".join(f"{values.mean():.3f}" for values in others.values()),
        "p = " + ", ".join(f"{p:.1g}" for p in p_values),
        over,
        ahead and max(p_values) < 0.01,
    )


def _p_greater(ours: np.ndarray, others: np.ndarray) -> float:
    return float(ranksums(ours, others, alternative="greater").pvalue)


def _gather(
    study: Mapping[str, Mapping[str, Any]],
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Final returns (runs,) and returns of rollouts (runs, rollouts) of each learner."""
    final: dict[str, list[float]] = {}
    returns: dict[str, list[list[float]]] = {}
    for key, part in study.items():
        name = key.split("-")[0]
        many = "final" in part  # a job of reaching is of several seeds
        finals = part["final"] if many else [float(np.mean(part["repeats"]))]
        final.setdefault(name, []).extend(finals)
        returns.setdefault(name, []).extend(part["returns"] if many else [part["returns"]])
    return (
        {name: np.array(values) for name, values in final.items()},
        {name: np.array(values) for name, values in returns.items()},
    )


def _needed(curves: np.ndarray, level: float) -> str:
    """Median number of rollouts until a curve is at the level, in words if it mostly never is."""
    reached = curves >= level
    first = np.where(reached.any(axis=1), reached.argmax(axis=1) + 1.0, np.inf)
    median = float(np.median(first))
    return f"{median:.0f}" if np.isfinite(median) else f"over {curves.shape[1]}"
