# SPDX-License-Identifier: Apache-2.0
"""Stopping rules side by side: sessions of one mean whose margins are drawn.

Beside the rule stand counting alone, and the sequential test on successes alone that needs the
fewest of them: a martingale, which any number of looks may be taken at, as in [Snyder2025].
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from reproduction.jobs import Job, study_of
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.practice.stopping_rule import CONFIDENCE, StoppingRule, rate_shown

COUNT, BUDGET = 29, 60  # successes that show the rate alone; rollouts of a session
RATES = (0.5, 0.8, 0.9, 0.95, 0.99, 0.999, 0.99999)  # true ones
MARGINS = ("one", "three", "dependent")  # one that decides of three; three alike, or dependent
SCATTERS = (0.7, 1.0, 1.4, 2.0)  # true one, relative to that which the task states
PLACES = {f"{m}, scatter {s}": (m, s) for m, s in product(MARGINS, SCATTERS)}
RULES = {"margins": "successes and margins", "counting": "successes", "test": "successes"}
HELD_OUT = range(100)  # seeds not used for tuning


class Drawn(NamedTuple):
    """What a stopping rule reads of a record."""

    success: bool
    margins: tuple[float, ...]
    z: list[float]
    kind: str = "mean"


def session(seed: int, rule: str, margins: str, scatter: float) -> dict[str, Any]:
    """Rollouts of sessions with each of `RATES` until they end, and whether they confirmed."""
    rng, found = np.random.default_rng([seed, MARGINS.index(margins)]), {}
    noise, shared = rng.standard_normal((BUDGET, 3)), rng.standard_normal((BUDGET, 1))
    noise = math.sqrt(0.5) * (noise + shared) if margins == "dependent" else noise
    for rate in RATES:
        means = [ndtri(rate), 9.0, 9.0] if margins == "one" else [ndtri(rate ** (1.0 / 3.0))] * 3
        rows = scatter * (noise + means)
        ended = {"margins": by_margins, "counting": counted, "test": tested}[rule](rows)
        found[str(rate)] = {"used": ended or BUDGET, "confirmed": ended is not None}
    return found


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
    rate, wealth = rate_shown(COUNT), 1.0
    for number, success in enumerate(rows.min(axis=1) > 0.0, start=1):
        wealth *= 1.0 + 0.9 * (success - rate) / rate
        if wealth >= 1.0 / (1.0 - CONFIDENCE):
            return number
    return None


def jobs(seeds: Sequence[int], places: Sequence[str], rules: Sequence[str]) -> list[Job]:
    """Sessions of every rule at every place."""
    wanted = []
    for place, rule, seed in product(places, rules, seeds):
        margins, scatter = PLACES[place]
        own = {"seed": seed, "rule": rule, "margins": margins, "scatter": scatter}
        wanted.append(Job(study_of(place, rule), f"seed-{seed}", session, own))
    return wanted


def line(sessions: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """By true rate: share of the sessions that confirmed, and median number of their rollouts."""
    lines = {}
    for rate in map(str, RATES):
        share = np.mean([each[rate]["confirmed"] for each in sessions])
        lines[rate] = f"{share:.2f} after {np.median([each[rate]['used'] for each in sessions]):g}"
    return lines
