# SPDX-License-Identifier: Apache-2.0
"""Two policies compared by pairs of rollouts: errors, order and number of rollouts."""

import numpy as np
import pytest

from wam_power_ros.practice.comparison import DECIDED, ERROR, Comparison, evidence
from wam_power_ros.tasks.task import Assessment

PAIRS = 60


def good(ret: float | None, success: bool = False) -> Assessment:
    return Assessment(ret, success=success)


def test_the_evidence_is_a_martingale_of_mean_one_if_no_policy_is_better() -> None:
    assert evidence(0, 0) == pytest.approx(1.0)
    for wins in range(6):
        for losses in range(6):
            later = 0.5 * (evidence(wins + 1, losses) + evidence(wins, losses + 1))
            assert later == pytest.approx(evidence(wins, losses))


def decisions(p: float, runs: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Pairs until policy 0, or 1, was called better; PAIRS + 1 for never. Shape (runs,) each."""
    table = [[evidence(w, n - w) for w in range(n + 1)] for n in range(PAIRS + 1)]
    wins = np.cumsum(rng.random((runs, PAIRS)) < p, axis=1)
    n, never = np.arange(1, PAIRS + 1), np.full((runs, 1), True)
    reached = []
    for own in (wins, n - wins):
        shown = np.array([[table[m][w] for m, w in zip(n, row, strict=True)] for row in own])
        reached.append(np.argmax(np.hstack([shown >= DECIDED, never]), axis=1) + 1)
    return reached[0], reached[1]


def test_equal_policies_are_called_different_in_at_most_5_percent_of_10_000_comparisons() -> None:
    first, second = decisions(0.5, 10_000, np.random.default_rng(71))
    assert np.mean(np.minimum(first, second) <= PAIRS) <= ERROR


def test_a_success_wins_and_of_two_alike_the_higher_return() -> None:
    found = Comparison()
    found.add((good(0.2, success=True), good(0.9)))
    found.add((good(0.3), good(0.4)))
    assert (found.won, found.alike, found.pairs) == ([1, 1], 0, 2)


def test_a_pair_that_cannot_be_judged_or_is_equal_counts_for_neither() -> None:
    found = Comparison()
    found.add((good(None), good(0.9)))
    found.add((good(0.5), good(0.5)))
    assert (found.won, found.alike, found.better) == ([0, 0], 2, None)


def test_the_policies_begin_by_turns_and_the_better_one_stays_it() -> None:
    found, first = Comparison(), []
    while found.better is None:
        first.append(found.order[0])
        found.add((good(0.1), good(0.2)))
    assert found.better == 1 and found.pairs == 8
    assert first == [0, 1] * 4
    for _ in range(30):
        found.add((good(0.2), good(0.1)))
    assert found.better == 1
