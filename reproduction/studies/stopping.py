# SPDX-License-Identifier: Apache-2.0
"""Stopping rules side by side: one mean is run until it is confirmed; its margins are drawn.

Beside the rule stand counting alone, and the sequential test on successes alone that needs the
fewest of them: a martingale, which any number of looks may be taken at, as in [Snyder2025].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from reproduction.studies.table import Row, Table
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.practice.stopping_rule import CONFIDENCE, StoppingRule, rate_shown

COUNT, BUDGET = 29, 60  # successes that show the rate alone; rollouts of a session
RATES = (0.5, 0.8, 0.9, 0.95, 0.99, 0.999, 0.99999)  # true ones
MARGINS = ("one", "three", "dependent")  # one that decides of three; three alike, or dependent
SCATTERS = (0.7, 1.0, 1.4, 2.0)  # true one, relative to that which the task states


class Drawn(NamedTuple):
    """What a stopping rule reads of a record."""

    success: bool
    margins: tuple[float, ...]
    z: list[float]
    kind: str = "mean"


def by_margins(rows: np.ndarray) -> int | None:
    """Rollout at which `StoppingRule` is satisfied by margins (n, c) in units of their scatter."""
    settings = PracticeSettings(budget=BUDGET, confirm=COUNT)
    rule = StoppingRule(settings, lambda record: record.margins, [1.0] * rows.shape[1])
    for number, row in enumerate(rows, start=1):
        rule.add(Drawn(bool(row.min() > 0.0), tuple(row), [0.0]))
        if rule.complete:
            return number
    return None


def counted(rows: np.ndarray) -> int | None:
    """Rollout at which COUNT have succeeded in a row."""
    row = 0
    for number, success in enumerate(rows.min(axis=1) > 0.0, start=1):
        row = row + 1 if success else 0
        if row == COUNT:
            return number
    return None


def tested(rows: np.ndarray) -> int | None:
    """Rollout at which a martingale refutes that the rate is at most that of COUNT in a row."""
    rate, wealth = rate_shown(COUNT, COUNT), 1.0
    for number, success in enumerate(rows.min(axis=1) > 0.0, start=1):
        wealth *= 1.0 + 0.9 * (success - rate) / rate
        if wealth >= 1.0 / (1.0 - CONFIDENCE):
            return number
    return None


RULES: Mapping[str, Callable[[np.ndarray], int | None]] = {
    "margins": by_margins,
    "counting": counted,
    "test": tested,
}


def runs(seeds: Sequence[int], rule: str, margins: str, scatter: float) -> dict[str, Any]:
    """Rollouts until each seed's mean of each rate is confirmed, None without confirmation."""
    found: dict[str, Any] = {str(rate): [] for rate in RATES}
    for seed in seeds:
        rng = np.random.default_rng([seed, MARGINS.index(margins)])
        noise, shared = rng.standard_normal((BUDGET, 3)), rng.standard_normal((BUDGET, 1))
        noise = math.sqrt(0.5) * (noise + shared) if margins == "dependent" else noise
        for rate in RATES:
            alike = [ndtri(rate ** (1.0 / 3.0))] * 3
            rows = noise + ([ndtri(rate), 9.0, 9.0] if margins == "one" else alike)
            found[str(rate)].append(RULES[rule](scatter * rows))
    return found


def line(found: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """By true rate: share of the means that are confirmed, and median number of rollouts."""
    lines = {}
    for rate, ended in found[0].items():
        share = np.mean([used is not None for used in ended])
        lines[rate] = f"{share:.2f} after {np.median([used or BUDGET for used in ended]):g}"
    return lines


TABLE = Table(
    {f"{m}, scatter {s}": {"margins": m, "scatter": s} for m, s in product(MARGINS, SCATTERS)},
    {name: Row("margins" if name == "margins" else "successes", {"rule": name}) for name in RULES},
    range(200),
    runs,
    line,
    together=True,
)
