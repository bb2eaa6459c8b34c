# SPDX-License-Identifier: Apache-2.0
"""The stopping rule states what it shows; clear margins show it with fewer rollouts."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import binom, norm, t
from toss_task import record_of

from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings, preset
from wam_power_ros.practice.stopping_rule import CONFIDENCE, StoppingRule, inside, rate_shown


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


def test_exactly_the_required_number_of_successes_without_a_failure_completes_it() -> None:
    stopping = rule(confirm=3)
    for said in ("1 of 1 succeeded", "2 of 2 succeeded", "3 of 3 succeeded"):
        assert not stopping.complete
        assert stopping.add(rollout(True)) == said
    assert stopping.complete == "3 of 3 succeeded: at least 37% will (95% confidence)"


def test_after_a_failure_the_learner_may_offer_another_mean_which_begins_anew() -> None:
    stopping = rule(confirm=3)
    assert stopping.add(rollout(False, z=0.1)) == ""
    stopping.add(rollout(True))
    stopping.add(rollout(True))
    assert stopping.add(rollout(False)) == "2 of 3 succeeded"
    assert stopping.z is None
    assert stopping.add(rollout(True)) == "3 of 4 succeeded" and not stopping.complete
    assert stopping.add(rollout(True, z=0.2)) == "1 of 1 succeeded"
    assert stopping.z.tolist() == [0.2, 1.0] and not stopping.complete


def test_explorations_do_not_count_and_call_for_the_mean_if_it_is_not_run_regularly() -> None:
    for mean_every in (0, 4):
        stopping = rule(confirm=3, mean_every=mean_every)
        stopping.add(rollout(True))
        stopping.add(rollout(False, kind="explore"))
        assert stopping.successes == 1 and not stopping.mean_is_due
        stopping.add(rollout(True, kind="explore"))
        assert stopping.successes == 1 and stopping.mean_is_due is (mean_every == 0)
        stopping.add(rollout(True))
        assert stopping.successes == 2 and not stopping.mean_is_due


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
def test_the_runs_are_forgotten_with_a_success_that_was_rated_down(
    record: Record, left: int
) -> None:
    stopping = rule()
    stopping.forget(record)  # no row yet
    stopping.add(rollout(True))
    stopping.add(rollout(True))
    stopping.forget(record)
    assert stopping.successes == left and (stopping.z is None) is (left == 0)


def test_policies_below_the_rate_that_is_shown_are_rarely_confirmed_by_their_count() -> None:
    for rate in (0.7, 0.95):
        for failures in (0, 1, 4):
            successes = next(n for n in range(1, 300) if rate_shown(n, n + failures) >= rate)
            by_chance = [binom.sf(n - 1, n + failures, rate) for n in (successes - 1, successes)]
            assert by_chance[0] > 1.0 - CONFIDENCE >= by_chance[1]
    assert 0.9 <= rate_shown(count := preset("flip").practice.confirm, count) < 0.91


def test_a_mean_that_failed_is_confirmed_by_its_count_of_all_its_runs_not_of_a_lucky_row() -> None:
    stopping = rule(confirm=29)
    stopping.add(rollout(True))
    stopping.add(rollout(False))
    while not stopping.complete:
        stopping.add(rollout(True))
    assert stopping.complete.startswith("46 of 47 succeeded: at least 90%")


def confirmed(
    margins: np.ndarray, confirm: int = 29, scatter: Sequence[float] = ()
) -> StoppingRule:
    """The rule after runs of one mean with these margins (n, c)."""
    stopping = rule(confirm, scatter=scatter)
    for row in margins:
        stopping.add(rollout(bool(row.min() > 0.0), margins=row.tolist()))
        if stopping.complete:
            break
    return stopping


@pytest.mark.parametrize(("count", "freedom"), [(2, 1), (5, 8), (30, 29)])
def test_the_probability_of_a_success_is_that_of_the_next_margin(count: int, freedom: int) -> None:
    """The posterior predictive distribution of a normal margin is a t distribution."""
    for ratio in (0.0, 1.5, 4.0):
        rates = np.exp(inside(np.array([ratio]), count, freedom))
        exact = t.cdf(ratio / np.sqrt(1.0 + 1.0 / count), freedom)
        assert rates.mean() == pytest.approx(exact, abs=5e-3)


def test_every_margin_takes_its_share_of_the_successes() -> None:
    """What is not known of one margin says nothing of another: expected shares multiply."""
    one, two = (np.exp(inside(np.full(m, 1.0), 2, 1)).mean() for m in (1, 2))
    assert two == pytest.approx(one**2, abs=0.01)


def test_clear_margins_confirm_with_few_rollouts_and_narrow_ones_do_not() -> None:
    clear = confirmed(np.array([[0.99, 5.0], [1.01, 5.1], [1.0, 4.9]] * 4))
    assert clear.successes < 8
    assert f"{clear.successes} of {clear.successes} succeeded, well inside" in clear.complete
    narrow = rule(29)
    barely = [[0.002, 5.0], [0.05, 5.0], [0.002, 5.1], [0.05, 5.0]]
    said = [narrow.add(rollout(True, margins=row)) for row in barely]
    assert any("too small margins" in each for each in said) and not narrow.complete


def test_margins_that_scatter_as_expected_confirm_sooner_and_never_by_a_lucky_row() -> None:
    """A row that happens to scatter little does not show more than what is expected of it."""
    rng = np.random.default_rng(5)
    rows = 4.0 + rng.standard_normal((40, 1))
    counts = [confirmed(rows, scatter=scatter).successes for scatter in ((), (1.0,), (1.0, 1.0))]
    assert counts[1] < counts[0] == counts[2]  # a scatter of other margins does not count
    alike = np.array([[1.0], [1.01], [0.99]] * 2)
    assert confirmed(alike).complete and not confirmed(alike, scatter=[1.0]).complete


def test_equal_margins_show_no_scatter_and_count_as_successes_alone() -> None:
    equal = confirmed(np.full((29, 1), 0.5))
    assert equal.successes == 29 and "well inside" not in equal.complete
    assert confirmed(np.full((29, 1), 0.5), scatter=[0.05]).successes < 8


def test_what_is_confirmed_names_all_runs_of_the_mean() -> None:
    stopping = rule(29, scatter=[1.0])
    stopping.add(rollout(True, margins=[6.0]))
    stopping.add(rollout(False, margins=[-0.5]))
    runs = 2
    while not stopping.complete:
        stopping.add(rollout(True, margins=[6.0]))
        runs += 1
    assert stopping.successes == runs - 1
    assert stopping.complete.startswith(f"{runs - 1} of {runs} succeeded, well inside")


def test_after_a_first_success_with_less_margin_than_lasts_a_better_mean_is_sought() -> None:
    for margin, goes_on in ((0.5, False), (4.0, True)):
        stopping = rule(29, scatter=[1.0])
        said = stopping.add(rollout(True, margins=[margin]))
        assert (stopping.z is not None) == goes_on != ("too small margins" in said)
        unknown = rule(29)
        unknown.add(rollout(True, margins=[margin]))
        assert unknown.z is not None


def test_a_mean_with_too_small_margins_is_run_on_while_no_better_mean_is_known() -> None:
    stopping = rule(5, scatter=[1.0])
    for count in range(1, 6):
        assert not stopping.complete
        stopping.add(rollout(True, margins=[0.1]))
        assert stopping.successes == count
    assert stopping.complete.startswith("5 of 5 succeeded")
    stopping = rule(5, scatter=[1.0])
    stopping.add(rollout(True, margins=[0.1]))
    stopping.add(rollout(True, z=1.0, margins=[0.1]))  # the better one
    assert stopping.successes == 1


def test_with_too_small_margins_means_are_sought_until_one_is_no_better_than_those_before() -> None:
    """Else a session goes from one mean to the next, and confirms none though all succeed."""
    stopping = rule(29, scatter=[1.0])
    for number, (margin, kept) in enumerate(((1.0, False), (1.2, False), (1.1, True))):
        said = stopping.add(rollout(True, z=float(number), margins=[margin]))
        assert (stopping.z is not None) == kept != ("too small margins" in said)
    stopping.add(rollout(True, z=2.0, margins=[1.5]))
    assert stopping.z is not None, "what it proves later is no reason to leave it"
    stopping.add(rollout(False, z=2.0, margins=[-0.1]))
    assert stopping.z is None
    stopping.add(rollout(True, z=3.0, margins=[1.6]))
    assert stopping.z is None, "better than all before"


def needed(failures: Sequence[Sequence[float] | None], z: float) -> int:
    """Successes until a mean at 0 is confirmed, after failures of a mean at z that succeeded."""
    stopping, count = rule(29), 0
    for margins in failures:
        stopping.add(rollout(True, z=z, margins=[5.0, 3.0]))
        stopping.add(rollout(False, z=z, margins=margins))
    while not stopping.complete:
        stopping.add(rollout(True, margins=[5.0 + 0.1 * (count % 3), 3.0 + 0.1 * (count % 2)]))
        count += 1
    return count


def test_a_run_far_outside_where_the_others_are_well_inside_is_explained_by_no_margin() -> None:
    """Else one that lands elsewhere now and then is confirmed by a lucky row of the next mean."""

    def successes(before: float, last: float) -> int:
        stopping, count = rule(29, scatter=[1.0]), 0
        for margin in (before, before, last):
            stopping.add(rollout(margin > 0.0, z=1.0, margins=[margin]))
        while not stopping.complete:
            stopping.add(rollout(True, margins=[5.0 + 0.1 * (count % 3)]))
            count += 1
        return count

    clear, far, narrow = successes(2.5, 2.5), successes(4.0, -9.0), successes(0.2, -0.3)
    assert clear == narrow < far - 3


def test_a_success_outside_a_limit_is_no_failure_for_another_reason() -> None:
    counts = []
    for outside in (0, 6):
        stopping, count = rule(29, scatter=[1.0]), 0
        for margin in (2.0, 2.0, *[-9.0] * outside):
            stopping.add(rollout(True, z=1.0, margins=[margin]))
        while not stopping.complete:
            stopping.add(rollout(True, margins=[5.0 + 0.1 * (count % 3)]))
            count += 1
        counts.append(count)
    assert counts[1] <= counts[0] < 8


def test_a_failure_that_no_margin_explains_asks_more_of_every_later_mean() -> None:
    explained = [needed(failures, z=1.0) for failures in ([], [[-0.1, 3.0]], [None])]
    assert explained[0] == explained[1] == explained[2] < 8
    assert explained[0] + 3 < needed([[4.0, 3.0]], z=1.0) < needed([[4.0, 3.0]] * 2, z=1.0) - 3
    of_a_bad_mean = rule(29)
    of_a_bad_mean.add(rollout(False, z=1.0, margins=[4.0, 3.0]))
    for k in range(explained[0]):
        of_a_bad_mean.add(rollout(True, margins=[5.0 + 0.1 * (k % 3), 3.0 + 0.1 * (k % 2)]))
    assert of_a_bad_mean.complete


def test_what_failed_of_a_mean_counts_when_it_is_run_again() -> None:
    assert needed([[-0.5, 3.0]], z=1.0) + 5 < needed([[-0.5, 3.0]], z=0.0)


def test_margins_that_are_not_known_of_every_success_do_not_count() -> None:
    stopping = rule(confirm=6)
    for k in range(6):
        assert not stopping.complete
        stopping.add(rollout(True, margins=None if k == 1 else [5.0 + 0.1 * k]))
    assert stopping.complete.startswith("6 of 6 succeeded: ")


@pytest.mark.parametrize("scatter", [(), (1.0, 1.0)])
def test_the_unit_of_the_margins_does_not_matter(scatter: Sequence[float]) -> None:
    rng, said, unit = np.random.default_rng(4), set(), 128.0
    for mean in np.linspace(0.0, 5.0, 30):
        rows = np.abs(mean + rng.standard_normal((12, 2)))
        rules = [rule(29, scatter=scatter), rule(29, scatter=[unit * each for each in scatter])]
        for row in rows:
            plain, other = (
                each.add(rollout(True, margins=(factor * row).tolist()))
                for each, factor in zip(rules, (1.0, unit), strict=True)
            )
            assert plain == other and rules[0].complete == rules[1].complete
            said.add(plain.partition(", ")[2])
    assert len(said) > 1, "some rows have ended"


@pytest.mark.parametrize(("alike", "expected"), [(1, 0.7), (3, None)])
def test_policies_below_the_rate_are_rarely_confirmed(alike: int, expected: float | None) -> None:
    """Normal margins of a policy of 0.9: one that decides, or three alike, looked at each time.

    Their standard deviation is 1.4 times the expected one, or not expected.
    """
    rng = np.random.default_rng(alike)
    scatter = () if expected is None else (expected,) * 3
    wrong, sessions = 0, 50
    for _ in range(sessions):
        rows = np.full((40, 3), 9.0) + rng.standard_normal((40, 3))
        rows[:, :alike] += norm.ppf(0.9 ** (1.0 / alike)) - 9.0
        wrong += "well inside" in confirmed(rows, scatter=scatter).complete
    share = 0.1  # of 300 seeds: 0.07 and 0.01
    assert wrong / sessions < share + 2.0 * np.sqrt(share * (1.0 - share) / sessions)
