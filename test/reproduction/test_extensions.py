# SPDX-License-Identifier: Apache-2.0
"""The extensions with small budgets; the chapter agrees with the results."""

from pathlib import Path

import numpy as np
import pytest

from reproduction import jobs
from reproduction.chapters.extensions import STUDY
from reproduction.studies import extensions
from reproduction.studies.extensions import (
    AUTO,
    DEMONSTRATION,
    PERSON,
    REACHING,
    REACHING_NOISY,
    SIGMA,
)


def test_the_quick_extensions_have_every_claim(tmp_path: Path) -> None:
    results = jobs.run(extensions.jobs("quick"), tmp_path)
    written = STUDY.chapter(results)
    assert len(written.claims) == 7 and "automatic" in written.html
    (person,) = results[PERSON].values()
    assert 0 <= person["rated"] <= 2 and person["used"] == 4
    (given,) = results[f"{DEMONSTRATION}with"].values()
    assert given["used"] == 6


def test_the_full_study_holds_seeds_that_nothing_was_tuned_on() -> None:
    jobs = extensions.jobs("full")
    assert len({job.name for job in jobs}) == len(jobs) == 2 * 5 + 8 * (3 + 1 + 2)
    seeds = {seed for job in jobs for seed in job.arguments.get("seeds", [])}
    seeds |= {job.arguments["seed"] for job in jobs if "seed" in job.arguments}
    assert min(seeds) == 501 and max(seeds) <= 599


def run(landed: float, used: int = 50, **other: object) -> dict[str, object]:
    flags = [k < round(10 * landed) for k in range(10)]
    outcomes = {"landed": flags, "true_flip": flags, "angle_deg": [100.0 + 80.0 * f for f in flags]}
    outcomes |= {"retests": [0.5 + 0.5 * landed] * 10, "used": used, "rated": 3, "refused": ""}
    return {**outcomes, "choice": "", "learnt_from": "", "sigma": 6.0, **other}


@pytest.mark.parametrize("better", [True, False])
def test_a_claim_is_met_only_if_the_results_say_so(better: bool) -> None:
    rng = np.random.default_rng(0)
    few = {f"seed-{k}": run(0.2 + 0.1 * (k % 3)) for k in range(12)}
    many = {f"seed-{k}": run(0.7 + 0.1 * (k % 3)) for k in range(12)}
    alone, helped = (few, many) if better else (many, few)
    sizes = {
        f"sigma-{s}": {"final": (level + 0.01 * rng.random(30)).tolist(), "sigma": [4.0] * 30}
        for s, level in ((AUTO, 0.7 if better else 0.3), (6, 0.5))
    }
    results = {
        REACHING: sizes,
        REACHING_NOISY: sizes,
        f"{SIGMA}{AUTO}": helped,
        f"{SIGMA}6": alone,
        PERSON: helped,
        f"{DEMONSTRATION}without": alone,
        f"{DEMONSTRATION}with": helped,
    }
    assert {claim.met for claim in STUDY.chapter(results).claims} == {better}


@pytest.mark.parametrize(
    ("count", "loss", "verdict"),
    [
        (40, 0.0, "met"),
        (40, 0.1, "not met"),
        (40, 0.029, "not met"),  # not known to be within the margin
        (6, 0.0, "not met"),  # nor is what differs by chance only
        (2, 0.0, "too few runs"),
    ],
)
def test_no_worse_is_a_margin_that_is_kept_and_not_a_difference_that_is_not_seen(
    count: int, loss: float, verdict: str
) -> None:
    rng = np.random.default_rng(1)
    fixed, auto = (level + 0.05 * rng.standard_normal((2, count)) for level in (0.7, 0.7 - loss))
    fixed, auto = (values - values.mean(axis=1, keepdims=True) for values in (fixed, auto))
    sizes = {
        f"sigma-{AUTO}": {"final": (0.7 - loss + auto[0]).tolist(), "sigma": [4.0] * count},
        "sigma-6": {"final": (0.7 + fixed[0]).tolist(), "sigma": [4.0] * count},
    }
    runs = {f"seed-{k}": run(0.5) for k in range(6)}
    results = {REACHING: sizes, REACHING_NOISY: sizes, PERSON: runs}
    results |= {f"{SIGMA}{AUTO}": runs, f"{SIGMA}6": runs}
    results |= {f"{DEMONSTRATION}{which}": runs for which in ("with", "without")}
    claims = [c for c in STUDY.chapter(results).claims if "without noise" in c.what]
    assert [claim.verdict for claim in claims] == [verdict]
