# SPDX-License-Identifier: Apache-2.0
"""The stopping rule states what it shows; clear margins show it with fewer rollouts."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import nct, norm
from toss_task import record_of

from wam_power_ros.practice import stopping_rule
from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.practice.stopping_rule import (
    CONFIDENCE,
    LOOK_CONFIDENCE,
    RECENT,
    ROW_MIN,
    StoppingRule,
    rate_shown,
    tolerance_factor,
)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rule that ends no row for being long."""
    monkeypatch.setattr(stopping_rule, "SEARCH", 100)


def rollout(
    success: bool, z: float = 0.0, kind: str = "mean", margins: Sequence[float] | None = None
) -> Record:
    observation = None if margins is None else {"margins": list(margins)}
    return record_of(kind=kind, z=[z, 1.0], success=success, observation=observation)


def rule(confirm: int = 3, mean_every: int = 4, scatter: Sequence[float] = ()) -> StoppingRule:
    settings = PracticeSettings(budget=50, mean_every=mean_every, confirm=confirm, retests=1)
    return StoppingRule(
        settings, lambda record: (record.observation or {}).get("margins", ()), scatter
    )


def test_exactly_the_required_number_of_successes_in_a_row_completes_it() -> None:
    stopping = rule(confirm=3)
    for said in ("1 success in a row", "2 successes in a row", "3 successes in a row"):
        assert not stopping.complete
        assert stopping.add(rollout(True)) == said
    assert stopping.complete == "3 of 3 succeeded: at least 37% will (95% confidence)"


def test_a_failure_ends_a_row_and_a_success_of_another_mean_begins_a_new_one() -> None:
    stopping = rule(confirm=3)
    assert stopping.add(rollout(False)) == ""
    stopping.add(rollout(True))
    stopping.add(rollout(True))
    assert stopping.add(rollout(False)) == "ended after 2 successes in a row"
    assert (stopping.z, stopping.count) == (None, 0)
    stopping.add(rollout(True))
    assert stopping.add(rollout(True, z=0.2)) == "1 success in a row"
    assert stopping.z.tolist() == [0.2, 1.0] and not stopping.complete


def test_explorations_neither_count_nor_end_a_row_and_call_for_the_mean_if_it_is_not_regular() -> (
    None
):
    for mean_every in (0, 4):
        stopping = rule(confirm=3, mean_every=mean_every)
        stopping.add(rollout(True))
        stopping.add(rollout(False, kind="explore"))
        assert stopping.count == 1 and not stopping.mean_is_due
        stopping.add(rollout(True, kind="explore"))
        assert stopping.count == 1 and stopping.mean_is_due is (mean_every == 0)
        stopping.add(rollout(True))
        assert stopping.count == 2 and not stopping.mean_is_due


@pytest.mark.parametrize(
    ("record", "left"),
    [
        (rollout(True), 0),
        (rollout(True, z=0.3), 2),  # of another mean
        (rollout(True, kind="explore"), 2),
    ],
)
def test_a_row_is_forgotten_with_a_success_that_was_rated_down(record: Record, left: int) -> None:
    stopping = rule()
    stopping.forget(record)  # no row yet
    stopping.add(rollout(True))
    stopping.add(rollout(True))
    stopping.forget(record)
    assert stopping.count == left and (stopping.z is None) is (left == 0)


@pytest.mark.parametrize(("count", "rate"), [(2, 0.7), (10, 0.9), (40, 0.97)])
def test_the_factor_is_that_of_the_one_sided_tolerance_interval(count: int, rate: float) -> None:
    root = np.sqrt(count)
    for freedom in (count - 1, count + 3):
        exact = nct.ppf(LOOK_CONFIDENCE, freedom, root * norm.ppf(rate)) / root
        assert tolerance_factor(count, freedom, rate) == pytest.approx(exact, rel=1e-6)


def confirmed(
    margins: np.ndarray, confirm: int = 29, scatter: Sequence[float] = ()
) -> StoppingRule:
    """The rule after successes of one mean with these margins (n, c)."""
    stopping = rule(confirm, scatter=scatter)
    for row in margins:
        stopping.add(rollout(True, margins=row.tolist()))
        if stopping.complete or stopping.z is None:
            break
    return stopping


@pytest.mark.usefixtures("patient")
def test_clear_margins_confirm_with_few_rollouts_and_narrow_ones_end_the_row() -> None:
    spread = np.array([[0.99, 5.0], [1.01, 5.1], [1.0, 4.9]] * 2)
    clear = confirmed(spread)
    assert clear.count == ROW_MIN
    assert "all well inside the limits: at least 90% will (95%" in clear.complete
    narrow = rule(29)
    barely = [[0.002, 5.0], [0.05, 5.0], [0.002, 5.1], [0.05, 5.0], [0.002, 5.1]]
    said = [narrow.add(rollout(True, margins=row)) for row in barely]
    assert said[-1] == "5 successes in a row, but with too small margins: learning goes on"
    assert (narrow.z, narrow.count, narrow.complete) == (None, 0, "")


@pytest.mark.usefixtures("patient")
def test_a_row_ends_when_the_rest_of_it_would_more_likely_fail_than_not() -> None:
    """Margins of r sd: 24 further successes have the probability Phi(r)^24, 2 more Phi(r)^2."""
    for mean, goes_on in ((1.8, False), (2.0, True)):
        rows = [[mean + each] for each in (-1.0, 1.0, 0.0, 1.0, -1.0)]
        sd = float(np.std(rows, ddof=1))
        assert (norm.cdf(mean) ** 24 > 0.5) == goes_on
        narrow = rule(29)
        for row in rows:
            narrow.add(rollout(True, margins=[row[0] - mean + mean * sd]))
        assert (narrow.count == 5) == goes_on
        last = rule(7)
        for row in rows:
            last.add(rollout(True, margins=[row[0] - mean + mean * sd]))
        assert last.count == 5


def test_margins_that_scatter_as_expected_confirm_sooner_and_never_by_a_lucky_row() -> None:
    """A row that happens to scatter little does not show more than what is expected of it."""
    rng = np.random.default_rng(5)
    rows = 4.0 + rng.standard_normal((40, 1))
    counts = [confirmed(rows, scatter=scatter).count for scatter in ((), (1.0,), (1.0, 1.0))]
    assert counts[1] < counts[0] == counts[2]  # a scatter of other margins does not count
    alike = np.array([[1.0], [1.01], [0.99]] * 2)
    assert confirmed(alike).complete and not confirmed(alike, scatter=[1.0]).complete


def test_each_row_that_a_failure_has_ended_asks_one_success_more_of_the_next() -> None:
    stopping = rule(29)
    stopping.add(rollout(False))  # ends no row
    for failed in range(3):
        for k in range(ROW_MIN + failed - 1):
            stopping.add(rollout(True, margins=[5.0 + 0.1 * (k % 3)]))
            assert not stopping.complete and stopping.count == k + 1
        stopping.add(rollout(False))
    for k in range(ROW_MIN + 3):
        assert not stopping.complete
        stopping.add(rollout(True, margins=[5.0 + 0.1 * (k % 3)]))
    assert "well inside" in stopping.complete


def test_a_failure_that_no_margin_explains_asks_for_two_more_successes_until_it_is_long_past() -> (
    None
):
    def needed(failures: Sequence[Sequence[float] | None]) -> int:
        stopping = rule(29)
        for margins in failures:
            stopping.add(rollout(False, margins=margins))
        for k in range(28):
            stopping.add(rollout(True, margins=[5.0 + 0.1 * (k % 3), 3.0 + 0.1 * (k % 2)]))
            if stopping.complete:
                return stopping.count
        return 29

    assert needed([]) == needed([[-0.1, 3.0]]) == needed([None]) == ROW_MIN
    assert needed([[4.0, 3.0]]) == ROW_MIN + 2
    assert needed([[4.0, 3.0]] * 2) == ROW_MIN + 4
    assert ROW_MIN + 4 < needed([[4.0, 3.0]] * 20) <= RECENT


def test_a_row_that_would_be_much_longer_than_that_of_a_better_mean_ends() -> None:
    said = "1 success in a row, but margins that need many more: learning goes on"
    assert rule(29, scatter=[1.0]).add(rollout(True, margins=[4.0])) == "1 success in a row"
    stopping, ended = rule(29, scatter=[1.0]), 0
    for z in range(20):
        if stopping.add(rollout(True, z=z, margins=[2.0])) != said:
            break
        assert stopping.z is None
        ended += 1
    needed = next((n for n in range(2, 29) if tolerance_factor(n, n + 3, rate_shown(29)) < 2.0), 29)
    # Each that has ended lets the next be longer: the arm may not be able to do better.
    assert ended == math.ceil((needed - 1 - ROW_MIN) / stopping_rule.SEARCH) - 1 > 0


@pytest.mark.parametrize(("alike", "expected"), [(1, None), (1, 0.7), (3, 1.0)])
def test_policies_below_the_rate_are_rarely_confirmed_by_their_margins(
    alike: int, expected: float | None
) -> None:
    """Normal margins of a policy of 0.9: one that decides, or three alike; looked at each time.

    Their standard deviation is not expected, is the expected one, or 1.4 times as large.
    """
    rng = np.random.default_rng(alike)
    scatter = () if expected is None else (expected,) * 3
    wrong, runs = 0, 500
    share = 0.9 ** (1.0 / alike)
    for _ in range(runs):
        rows = np.full((40, 3), 9.0) + rng.standard_normal((40, 3))
        rows[:, :alike] += norm.ppf(share) - 9.0
        failed = np.flatnonzero(rows.min(axis=1) < 0.0)
        row = rows[: failed[0] if len(failed) else 40]
        wrong += bool(confirmed(row, scatter=scatter).complete)
    error = np.sqrt(CONFIDENCE * (1.0 - CONFIDENCE) / runs)
    assert wrong / runs < 1.0 - CONFIDENCE + 2.0 * error
