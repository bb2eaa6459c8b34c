# SPDX-License-Identifier: Apache-2.0
"""Jobs of the tests of studies, in a module of their own: workers import it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np


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
