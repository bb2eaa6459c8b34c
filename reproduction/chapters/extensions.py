# SPDX-License-Identifier: Apache-2.0
"""Chapter of the extensions that the paper asks for, computed from their results."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import ranksums, ttest_ind

from reproduction.chapter import Chapter, Claim, Table
from reproduction.jobs import Results
from reproduction.studies.extensions import (
    AUTO,
    DEMONSTRATION,
    LATER,
    PERSON,
    REACHING,
    REACHING_NOISY,
    SIGMA,
)
from wam_power_ros.reporting.terminal import counted

SIGNIFICANCE = 0.05
MARGIN = 0.03  # negligible difference of mean returns, as in the claims of reaching
PAPER_SIGMA = "6"  # size of the elite in the paper


def chapter(results: Results) -> Chapter:
    """Chapter of `extensions.jobs`; ignores results of other studies."""
    return Chapter(
        title="Extensions the paper asks for (Sec. IV)",
        text=[
            "The paper sets the size of the elite by hand and asks for a mechanism that selects "
            "it automatically, and for a person who rewards, punishes, or provides new examples "
            "while the robot learns. These are features of the learner node; this chapter measures "
            "the effect of each. p is of a two-sided rank-sum test."
        ],
        parts=[_sigma(results), _person(results), _demonstration(results)],
    )


def _sigma(results: Results) -> Chapter:
    pancake = {
        study.removeprefix(SIGMA): runs
        for study, runs in results.items()
        if study.startswith(SIGMA)
    }
    tasks, sizes = {}, {}  # task -> size of the elite -> returns; task -> automatic sizes
    for task, study in (("without noise", REACHING), ("noisy returns", REACHING_NOISY)):
        by_size = {key.removeprefix("sigma-"): run for key, run in results[study].items()}
        tasks[f"reaching, {task}"] = {name: run["final"] for name, run in by_size.items()}
        sizes[f"reaching, {task}"] = by_size[AUTO]["sigma"]
    tasks["pancake, Eq. 5"] = {name: _means(runs, "retests") for name, runs in pancake.items()}
    sizes["pancake, Eq. 5"] = [run["sigma"] for run in pancake[AUTO].values()]
    names = list(dict.fromkeys(name for values in tasks.values() for name in values))
    rows, best, claims, sentences = [], [], [], []
    for task, values in tasks.items():
        medians = {name: float(np.median(values[name])) for name in values}
        rows.append([task, *(_spread(values[name]) if name in values else "–" for name in names)])
        top = max(medians, key=medians.__getitem__)
        best.append((len(rows) - 1, 1 + names.index(top)))
        fixed = {name: medians[name] for name in medians if name != AUTO}
        good, bad = max(fixed, key=fixed.__getitem__), min(fixed, key=fixed.__getitem__)
        auto, best_fixed = values[AUTO], values[good]
        low, high = _interval(auto, best_fixed)
        what = f"Automatic elite at most {MARGIN} worse than the best fixed one: {task}"
        measured = f"{np.mean(auto) - np.mean(best_fixed):+.3f} against σ = {good}"
        interval = "no interval of one run"
        if math.isfinite(low):
            interval = f"90 % interval {low:+.3f} to {high:+.3f}"
        worst = np.mean(auto) - np.mean(values[bad])
        spread = f"{interval}; against the worst, σ = {bad}: {worst:+.3f}"
        over = f"{counted(len(auto), 'run')} each"
        count = min(len(auto), len(best_fixed))
        claims.append(Claim(what, "proposed", measured, spread, over, low > -MARGIN, runs=count))
        chosen = np.array([size for size in sizes[task] if size is not None])
        sentences.append(
            f"{task}: median {np.median(chosen):.0f} ({chosen.min():.0f} to {chosen.max():.0f})"
        )
    return Chapter(
        "Automatic size of the elite",
        [
            "After every rollout the elite gets the size of highest expected return, estimated by "
            "leaving rollouts out of the elite in turn. Median sizes of the runs: "
            f"{'; '.join(sentences)}."
        ],
        claims,
        [
            Table(
                "Return of the final mean without noise (reaching), mean Eq. 5 of the re-tests "
                "(pancake): median and quartiles of the runs, by size of the elite.",
                ("task", *(f"σ = {name}" if name != AUTO else "automatic" for name in names)),
                rows,
                best,
            )
        ],
    )


def _person(results: Results) -> Chapter:
    alone, helped = results[f"{SIGMA}{PAPER_SIGMA}"], results[PERSON]
    count = [run["rated"] for run in helped.values()]
    return Chapter(
        "Rewards and punishments by a person",
        [
            "A simulated person who knows the ground truth rewards true flips that are caught and "
            f"punishes rollouts that are not caught, {np.median(count):.0f} rollouts in the median "
            f"session ({min(count)} to {max(count)}). The sessions use the paper's preset without "
            "its stopping rule; its return, Eq. 5, does not require a catch."
        ],
        *_compared("A person's ratings", alone, helped),
    )


def _demonstration(results: Results) -> Chapter:
    alone, helped = (results[f"{DEMONSTRATION}{which}"] for which in ("without", "with"))
    taken = sum(run["learnt_from"] == LATER for run in helped.values())
    refused = sum(bool(run["refused"]) for run in helped.values())
    return Chapter(
        "A demonstration in the middle of learning",
        [
            "Sessions of the shipped default begin with a weak demonstrator who hardly turns the "
            "pancake; in half of them a practised one gives another demonstration after some "
            f"rollouts. It was learnt from in {taken} of {counted(len(helped), 'session')} "
            f"and refused in {refused}."
        ],
        *_compared("A later demonstration", alone, helped),
    )


def _compared(
    what: str, alone: Mapping[str, Any], helped: Mapping[str, Any]
) -> tuple[list[Claim], list[Table]]:
    """Claims and table of re-tests without and with a person."""
    claims, rows = [], []
    for name, key, form in (
        ("landed, share of re-tests", "landed", ".0%"),
        ("true flips, share of re-tests", "true_flip", ".0%"),
        ("angle at t_f [degrees]", "angle_deg", ".0f"),
        ("return", "retests", ".3f"),
    ):
        without, with_ = _means(alone, key), _means(helped, key)
        p = _p(without, with_)
        rows.append([name, _spread(without, form), _spread(with_, form), f"{p:.2g}"])
        if key in ("landed", "true_flip"):
            means = f"mean {np.mean(with_):.0%} against {np.mean(without):.0%} without"
            met = bool(np.mean(with_) > np.mean(without) and p < SIGNIFICANCE)
            over = f"{counted(len(with_), 'session')} each"
            count = min(len(with_), len(without))
            title = f"{what}: {name}"
            claims.append(Claim(title, "proposed", means, f"p = {p:.2g}", over, met, runs=count))
    used = [[run["used"] for run in runs.values()] for runs in (alone, helped)]
    rows.append(["rollouts used", *(_spread(u, ".0f") for u in used), f"{_p(*used):.2g}"])
    head = ("of a session, median and quartiles", "without", "with", "p")
    return claims, [Table(f"{what}: final policies of the sessions.", head, rows)]


def _interval(one: Sequence[float], other: Sequence[float]) -> tuple[float, float]:
    """90 % interval of the difference of two means, by Welch's t; infinite for a single run."""
    if min(len(one), len(other)) < 2:
        return -math.inf, math.inf
    if not np.ptp(one) and not np.ptp(other):
        return (float(np.mean(one) - np.mean(other)),) * 2
    found = ttest_ind(one, other, equal_var=False).confidence_interval(0.9)
    return float(found.low), float(found.high)


def _means(runs: Mapping[str, Mapping[str, Any]], key: str) -> list[float]:
    """Mean over the re-tests of each session; 0 for a session without re-tests."""
    values = [[value for value in run[key] if value is not None] for run in runs.values()]
    return [float(np.mean(some)) if some else 0.0 for some in values]


def _p(one: Sequence[float], other: Sequence[float]) -> float:
    return float(ranksums(one, other).pvalue)


def _spread(values: Sequence[float], form: str = ".3f") -> str:
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
    return f"{middle:{form}} ({low:{form}}–{high:{form}})"
