# SPDX-License-Identifier: Apache-2.0
"""Statistics and tables of the extensions that the paper asks for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import ranksums, ttest_ind

from reproduction.chapter import Study
from reproduction.jobs import Results
from reproduction.studies import extensions
from reproduction.studies.extensions import (
    AUTO,
    DEMONSTRATION,
    LATER,
    PERSON,
    REACHING,
    REACHING_NOISY,
    SIGMA,
)

SIGNIFICANCE = 0.05
MARGIN = 0.03  # negligible difference of mean returns, as in the claims of reaching
PAPER_SIGMA = "6"  # size of the elite in the paper
COMPARED = (  # what of the re-tests, its field, its format
    ("landed, share of re-tests", "landed", ".0%"),
    ("true flips, share of re-tests", "true_flip", ".0%"),
    ("angle at t_f [degrees]", "angle_deg", ".0f"),
    ("return", "retests", ".3f"),
)


def values(results: Results) -> dict[str, Any]:
    """Names of the template; ignores results of other studies."""
    alone, person = results[f"{SIGMA}{PAPER_SIGMA}"], results[PERSON]
    without, later = (results[f"{DEMONSTRATION}{which}"] for which in ("without", "with"))
    return {
        "margin": MARGIN,
        **_sigma(results),
        "rated": [run["rated"] for run in person.values()],
        "later": later,
        "taken": sum(run["learnt_from"] == LATER for run in later.values()),
        "refused": sum(bool(run["refused"]) for run in later.values()),
        "rating": _compared(alone, person),
        "demonstration": _compared(without, later),
    }


def _sigma(results: Results) -> dict[str, Any]:
    """Automatic and fixed sizes of the elite on each task."""
    pancake = {
        study.removeprefix(SIGMA): runs
        for study, runs in results.items()
        if study.startswith(SIGMA)
    }
    returns, sizes = {}, {}  # task -> size of the elite -> returns; task -> automatic sizes
    for task, study in (("without noise", REACHING), ("noisy returns", REACHING_NOISY)):
        by_size = {key.removeprefix("sigma-"): run for key, run in results[study].items()}
        returns[f"reaching, {task}"] = {name: run["final"] for name, run in by_size.items()}
        sizes[f"reaching, {task}"] = by_size[AUTO]["sigma"]
    returns["pancake, Eq. 5"] = {name: _means(runs, "retests") for name, runs in pancake.items()}
    sizes["pancake, Eq. 5"] = [run["sigma"] for run in pancake[AUTO].values()]
    names = list(dict.fromkeys(name for of_task in returns.values() for name in of_task))
    tasks, rows, best = [], [], []
    for task, of_task in returns.items():
        medians = {name: float(np.median(of_task[name])) for name in of_task}
        best.append((len(rows), 1 + names.index(max(medians, key=medians.__getitem__))))
        rows.append([task, *(_spread(of_task[name]) if name in of_task else "–" for name in names)])
        fixed = {name: medians[name] for name in medians if name != AUTO}
        good, bad = max(fixed, key=fixed.__getitem__), min(fixed, key=fixed.__getitem__)
        low, high = _interval(of_task[AUTO], of_task[good])
        tasks.append(
            {
                "name": task,
                "good": good,
                "bad": bad,
                "auto": np.array(of_task[AUTO]),
                "best": np.array(of_task[good]),
                "worst": np.array(of_task[bad]),
                "low": low,
                "high": high,
                "runs": min(len(of_task[AUTO]), len(of_task[good])),
                "sizes": np.array([size for size in sizes[task] if size is not None]),
            }
        )
    head = ["task", *(f"σ = {name}" if name != AUTO else "automatic" for name in names)]
    return {"tasks": tasks, "head": head, "rows": rows, "best": best}


def _compared(alone: Mapping[str, Any], helped: Mapping[str, Any]) -> dict[str, Any]:
    """Re-tests without and with a person: rows of the table, and what the claims need."""
    claims, rows = [], []
    for name, key, form in COMPARED:
        without, with_ = _means(alone, key), _means(helped, key)
        p = _p(without, with_)
        rows.append([name, _spread(without, form), _spread(with_, form), f"{p:.2g}"])
        if key in ("landed", "true_flip"):
            means = {"with_": np.mean(with_), "without": np.mean(without)}
            met = means["with_"] > means["without"] and p < SIGNIFICANCE
            claims.append({"what": name, **means, "p": p, "met": met})
    used = [[run["used"] for run in runs.values()] for runs in (alone, helped)]
    rows.append(["rollouts used", *(_spread(u, ".0f") for u in used), f"{_p(*used):.2g}"])
    counts = {"sessions": len(helped), "runs": min(len(alone), len(helped))}
    return {"claims": claims, "rows": rows, **counts}


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
    known = [[value for value in run[key] if value is not None] for run in runs.values()]
    return [float(np.mean(some)) if some else 0.0 for some in known]


def _p(one: Sequence[float], other: Sequence[float]) -> float:
    return float(ranksums(one, other).pvalue)


def _spread(sample: Sequence[float], form: str = ".3f") -> str:
    low, middle, high = np.quantile(sample, (0.25, 0.5, 0.75))
    return f"{middle:{form}} ({low:{form}}–{high:{form}})"


STUDY = Study(
    "Extensions the paper asks for (Sec. IV)",
    extensions.jobs,
    values,
    Path(__file__).with_suffix(".html.j2"),
)
