# SPDX-License-Identifier: Apache-2.0
"""The stopping rule states what it shows; clear margins show it with fewer rollouts."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import nct, norm

from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings, preset
from wam_power_ros.practice.stopping_rule import (
    CONFIDENCE,
    ROW_MIN,
    StoppingRule,
    rate_shown,
    tolerance_factor,
)


def rollout(
    success: bool, z: float = 0.0, kind: str = "mean", margins: Sequence[float] | None = None
) -> Record:
    return Record(
        number=1,
        id="trial-0001",
        kind=kind,
        demonstration="demonstration-1",
        attempt=1,
        z=[z, 1.0],
        theta=[z, 1.0],
        learnt=True,
        learnt_as=[z, 1.0],
        ret=0.5,
        terms={},
        success=success,
        why="",
        note="",
        observation=None if margins is None else {"margins": list(margins)},
        fault="",
        generator={},
        bag="",
        truth=None,
        clock={},
    )


def rule(confirm: int = 3, mean_every: int = 4, scatter: Sequence[float] = ()) -> StoppingRule:
    settings = PracticeSettings(budget=50, mean_every=mean_every, confirm=confirm, retests=1)
    return StoppingRule(
        settings, lambda record: (record.observation or {}).get("margins", ()), scatter
    )


def test_exactly_the_required_number_of_successes_in_a_row_completes_it() -> None:
    stopping = rule(confirm=3)
    for count in (1, 2, 3):
        assert not stopping.complete
        assert (
            stopping.add(rollout(True))
            == f"{count} {'success' if count == 1 else 'successes'} in a row"
        )
        assert stopping.z.tolist() == [0.0, 1.0]
    assert stopping.complete == "3 of 3 succeeded: at least 37% will (95% confidence)"


def test_a_success_of_another_mean_begins_a_new_row() -> None:
    stopping = rule(confirm=2)
    stopping.add(rollout(True, z=0.1))
    assert stopping.add(rollout(True, z=0.2)) == "1 success in a row"
    assert not stopping.complete and stopping.z.tolist() == [0.2, 1.0]
    stopping.add(rollout(True, z=0.2))
    assert stopping.complete


def test_a_failure_ends_the_row() -> None:
    stopping = rule(confirm=3)
    assert stopping.add(rollout(False)) == ""
    stopping.add(rollout(True))
    stopping.add(rollout(True))
    assert stopping.add(rollout(False)) == "ended after 2 successes in a row"
    assert (stopping.z, stopping.count) == (None, 0)
    assert stopping.add(rollout(True)) == "1 success in a row"


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


def test_a_rule_of_no_successes_is_never_complete() -> None:
    stopping = rule(confirm=0, mean_every=0)
    for record in (rollout(True), rollout(True, kind="explore"), rollout(False)):
        assert stopping.add(record) == ""
        assert not stopping.complete and stopping.z is None and not stopping.mean_is_due


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


@pytest.mark.parametrize("rate", [0.7, 0.9, 0.95])
def test_policies_below_the_rate_that_is_shown_are_rarely_confirmed_by_their_count(
    rate: float,
) -> None:
    count = next(n for n in range(1, 100) if rate_shown(n) >= rate)
    assert rate**count <= 1.0 - CONFIDENCE < rate ** (count - 1)


@pytest.mark.parametrize("name", ["hindsight", "model_based", "return_only", "corrections_only"])
def test_an_answer_of_the_preset_succeeds_nine_times_of_ten(name: str) -> None:
    assert 0.9 <= rate_shown(preset("flip", name).practice.confirm) < 0.91


@pytest.mark.parametrize("count", [2, 4, 10, 40])
@pytest.mark.parametrize("rate", [0.7, 0.9, 0.97])
@pytest.mark.parametrize("look", [1, 2, 30])
def test_the_factor_is_that_of_the_one_sided_tolerance_interval(
    count: int, rate: float, look: int
) -> None:
    root, wrong = np.sqrt(count), (1.0 - CONFIDENCE) / (look * (look + 1))
    for freedom in (count - 1, count + 3):
        exact = nct.isf(wrong, freedom, root * norm.ppf(rate)) / root
        assert tolerance_factor(count, freedom, rate, look) == pytest.approx(exact, rel=1e-6)


def test_all_looks_of_a_session_together_are_wrong_in_five_of_a_hundred() -> None:
    one = norm.ppf(0.9)
    shares = [
        nct.sf(math.sqrt(5) * tolerance_factor(5, 4, 0.9, look), 4, math.sqrt(5) * one)
        for look in range(1, 61)
    ]
    assert shares == sorted(shares, reverse=True)
    assert 0.045 < sum(shares) < 1.0 - CONFIDENCE


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


def test_clear_margins_confirm_with_three_and_narrow_ones_end_the_row() -> None:
    spread = np.array([[0.99, 5.0], [1.01, 5.1], [1.0, 4.9]] * 2)
    clear = confirmed(spread)
    assert clear.count == ROW_MIN
    assert "all well inside the limits" in clear.complete and "at least 90%" in clear.complete
    narrow = rule(29)
    said = [narrow.add(rollout(True, margins=row)) for row in ([0.002, 5.0], [0.05, 5.0], [0.0, 5])]
    assert "margins too small to confirm them" in said[-1]
    assert (narrow.z, narrow.count, narrow.complete) == (None, 0, "")


def test_a_row_ends_when_the_rest_of_it_would_more_likely_fail_than_not() -> None:
    """One of whose margins of r sd nothing but 29 successes shows 0.9 succeeds with Phi(r)^26."""
    rows = np.array([-1.0, 1.0, 0.0])
    for mean, goes_on in ((1.7, False), (2.2, True)):
        assert (norm.cdf(mean) ** 26 > 0.5) == goes_on
        for confirm in (29, 5):  # 2 more are likely to succeed in any case
            stopping = rule(confirm)
            said = [stopping.add(rollout(True, margins=[mean + each])) for each in rows][-1]
            assert ("too small" in said) == (confirm == 29 and not goes_on)


def test_margins_that_scatter_as_expected_confirm_sooner_and_never_by_a_lucky_row() -> None:
    """A row that happens to scatter little does not show more than what is expected of it."""
    rng = np.random.default_rng(5)
    rows = 5.0 + rng.standard_normal((40, 1))
    counts = [confirmed(rows, scatter=scatter).count for scatter in ((), (1.0,))]
    assert counts[1] < counts[0]
    alike = np.array([[1.5], [1.51], [1.49]])
    assert confirmed(alike).complete and not confirmed(alike, scatter=[1.0]).complete


def test_no_mean_is_left_before_three_successes_have_shown_how_it_scatters() -> None:
    stopping = rule(29, scatter=[1.0])
    for z in range(2):  # a second one, too
        said = [stopping.add(rollout(True, z=z, margins=[0.5])) for _ in range(ROW_MIN)]
        assert ["too small" in each for each in said] == [False] * (ROW_MIN - 1) + [True]


def test_failures_that_no_margin_explains_ask_for_more_successes_and_explained_ones_do_not() -> (
    None
):
    def needed(failures: Sequence[Sequence[float] | None], successes: int = 0) -> int:
        stopping = rule(29)
        for margins in failures:
            stopping.add(rollout(False, margins=margins))
        for k in range(29):
            stopping.add(rollout(True, margins=[5.0 + 0.1 * (k % 3), 3.0 + 0.1 * (k % 2)]))
            if stopping.complete:
                return stopping.count
        return 29

    clear = needed([])
    assert clear == needed([[-0.1, 3.0]]) == needed([None]) < needed([[4.0, 3.0]])
    assert needed([[4.0, 3.0]]) < needed([[4.0, 3.0]] * 3) <= 29
    # They weigh less, the more other runs there were.
    assert needed([[4.0, 3.0]] + [[-0.1, 3.0]] * 20) < needed([[4.0, 3.0]])


def test_margins_that_are_not_known_of_every_success_do_not_count() -> None:
    stopping = rule(confirm=6)
    for k in range(5):
        stopping.add(rollout(True, margins=None if k == 1 else [5.0 + 0.1 * k]))
        assert not stopping.complete
    stopping.add(rollout(True, margins=[5.0]))
    assert stopping.complete == "6 of 6 succeeded: at least 61% will (95% confidence)"


def test_a_row_that_would_be_long_ends_and_the_next_may_be_twice_as_long() -> None:
    """The arm may not be able to do better: two rows of clear but wide margins end, then one stays.

    Their mean is 2.6 sd, so that no row of fewer than a dozen shows anything.
    """
    stopping, lengths = rule(29), []
    for z in range(4):
        for k in range(29):
            said = stopping.add(rollout(True, z=z, margins=[2.6 + (-1.0) ** k]))
            if stopping.z is None or stopping.complete:
                break
        lengths.append(said)
    assert "need many more" in lengths[0] and stopping.complete


@pytest.mark.parametrize("expected", [1.0, 0.7])
def test_sessions_of_a_policy_below_the_rate_are_rarely_confirmed_in_any_of_their_rows(
    expected: float,
) -> None:
    """60 rollouts of a policy of 0.9 with three margins; scattering as expected, or 1.4 times."""
    rng, wrong, runs = np.random.default_rng(3), 0, 500
    for _ in range(runs):
        stopping = rule(29, scatter=(expected,) * 3)
        for margins in norm.ppf(0.9 ** (1.0 / 3.0)) + rng.standard_normal((60, 3)):
            stopping.add(rollout(bool(margins.min() > 0.0), margins=margins.tolist()))
        wrong += bool(stopping.complete)
    assert wrong / runs < (0.05 if expected == 1.0 else 0.10)


def test_a_row_of_the_whole_count_confirms_whatever_its_margins() -> None:
    stopping = rule(confirm=9)
    for k in range(9):
        stopping.add(rollout(True, margins=[2.0 + (-1.0) ** k]))
    assert stopping.complete == "9 of 9 succeeded: at least 72% will (95% confidence)"


@pytest.mark.parametrize("expected", [None, 1.0, 0.7])
@pytest.mark.parametrize("alike", [1, 3])
def test_policies_below_the_rate_are_rarely_confirmed_by_their_margins(
    alike: int, expected: float | None
) -> None:
    """Normal margins of a policy of 0.9: one that decides, or three alike; looked at each time.

    Their standard deviation is not expected, is the expected one, or 1.4 times as large.
    """
    rng = np.random.default_rng(alike)
    scatter = () if expected is None else (expected,) * 3
    wrong, runs = 0, 4000
    share = 0.9 ** (1.0 / alike)
    for _ in range(runs):
        rows = np.full((40, 3), 9.0) + rng.standard_normal((40, 3))
        rows[:, :alike] += norm.ppf(share) - 9.0
        failed = np.flatnonzero(rows.min(axis=1) < 0.0)
        row = rows[: failed[0] if len(failed) else 40]
        wrong += bool(confirmed(row, scatter=scatter).complete)
    error = np.sqrt(CONFIDENCE * (1.0 - CONFIDENCE) / runs)
    assert wrong / runs < 1.0 - CONFIDENCE + 2.0 * error
