# SPDX-License-Identifier: Apache-2.0
"""Jobs of the tests of studies, in a module of their own as workers import it; a study of them."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from reproduction.chapter import Study
from reproduction.jobs import Job, Results
from wam_power_ros.reporting import figures

SECONDS = 0.0  # that a run of the study takes


def draw(seed: int, seconds: float = 0.0) -> dict[str, Any]:
    """Numbers with all their digits, after a while [s]."""
    time.sleep(seconds)
    return {"numbers": np.random.default_rng(seed).standard_normal(4).tolist()}


def count(log: str) -> dict[str, Any]:
    """Leaves a trace of having been computed."""
    with Path(log).open("a") as file:
        file.write("x")
    return {"done": True}


def fail(why: str) -> dict[str, Any]:
    """Raises."""
    raise RuntimeError(why)


def give(what: str) -> dict[str, Any]:
    """What no result may be."""
    return {"nan": {"value": float("nan")}, "array": {"value": np.zeros(3)}}[what]


def jobs(scale: str) -> list[Job]:
    """As every study has them."""
    count = {"full": 12, "quick": 3}[scale]
    return [
        Job("draws", f"seed-{seed}", draw, {"seed": seed, "seconds": SECONDS})
        for seed in range(1, 1 + count)
    ]


def values(results: Results) -> dict[str, Any]:
    """As every study has them."""
    means = [float(np.mean(result["numbers"])) for result in results["draws"].values()]
    return {
        "means": np.array(means),
        "rows": [[key, f"{mean:.3f}"] for key, mean in zip(results["draws"], means, strict=True)],
        "drawn": figures.learning_curve(means),
    }


STUDY = Study("Draws", jobs, values, Path(__file__).with_suffix(".html.j2"))
