# SPDX-License-Identifier: Apache-2.0
"""Infeasible samples are rejected or shrunk; the stopping rule counts successes in a row."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from toss_task import AnyArm, demonstrated_policy

from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.power import Power
from wam_power_ros.practice.improvement import (
    HALVINGS_MAX,
    REJECTIONS_MAX,
    StoppingRule,
    feasibility,
    sample,
    shrink,
)
from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings, preset

SETTINGS = preset("flip")
PARAMETERS = SETTINGS.make_task({}).parametrization(demonstrated_policy("flick-1", seed=1))
RAN = np.zeros(PARAMETERS.size)
RIGHT = np.eye(PARAMETERS.size)[PARAMETERS.groups["catch_shift"].start]  # catches further out


def never(z: np.ndarray) -> bool:
    raise AssertionError(f"simulated {z}")


def feasible(refuse: Callable[[Policy], str]) -> Callable[[np.ndarray], bool]:
    return feasibility(PARAMETERS, AnyArm(refuse), 0, "sample")


def place(policy: Policy) -> float:
    return float(policy.attractors[-1, 0])


def learner(seed: int) -> Power:
    return Power(PARAMETERS.size, SETTINGS.learner_settings, np.random.default_rng(seed))


@pytest.mark.requirement("S-31")
@given(share=st.floats(0.02, 1.2), far=st.floats(0.5, 2.0))
def test_what_is_infeasible_is_shrunk_no_further_than_needed(share: float, far: float) -> None:
    z = far * RIGHT
    end, begin = (place(PARAMETERS.policy(point, "asked")[0]) for point in (z, RAN))
    limit = begin + share * (end - begin)
    is_feasible = feasible(lambda policy: "too far" * (place(policy) > limit))
    given_back, halved = shrink(z, RAN, is_feasible)
    assert place(PARAMETERS.policy(given_back, "allowed")[0]) <= limit
    assert np.array_equal(given_back, z) == (halved == 0) == (share >= 1.0)
    if halved not in (0, HALVINGS_MAX):
        assert place(PARAMETERS.policy(2.0 * given_back, "one-less")[0]) > limit
    again, _ = shrink(z, RAN, never, halved)
    assert np.array_equal(again, given_back)


@pytest.mark.requirement("S-31")
@given(seed=st.integers(0, 1000), share=st.sampled_from([0.0, 0.5, 0.9, 1.0]))
def test_a_sample_is_feasible_or_what_ran_and_its_count_restores_it(
    seed: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    verdicts: dict[float, bool] = {}

    def infeasible(policy: Policy) -> str:
        return "no" * verdicts.setdefault(place(policy), bool(rng.random() < share))

    once, twice = learner(seed), learner(seed)
    z, count = sample(once, RAN, feasible(infeasible))
    assert np.array_equal(z, RAN) or not infeasible(PARAMETERS.policy(z, "tried")[0])
    assert (share < 1.0) or count == REJECTIONS_MAX + HALVINGS_MAX
    again, _ = sample(twice, RAN, never, count)
    assert np.array_equal(again, z)
    assert np.array_equal(once.ask(), twice.ask())  # both have drawn as often


def rollout(success: bool, z: float = 0.0, kind: str = "mean", note: str = "") -> Record:
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
        note=note,
        observation=None,
        fault="",
        generator={},
        bag="",
        truth=None,
        clock={},
    )


def rule(confirm: int = 3, mean_every: int = 4) -> StoppingRule:
    settings = PracticeSettings(budget=50, mean_every=mean_every, confirm=confirm, retests=1)
    return StoppingRule(settings, lambda record: record.note != "barely")


def test_exactly_the_required_number_of_successes_in_a_row_completes_it() -> None:
    stopping = rule(confirm=3)
    for count in (1, 2, 3):
        assert not stopping.complete
        assert stopping.add(rollout(True)) == f"{count} of 3 successes in a row"
        assert stopping.z.tolist() == [0.0, 1.0]
    assert stopping.complete


def test_a_success_of_another_mean_begins_a_new_row() -> None:
    stopping = rule(confirm=2)
    stopping.add(rollout(True, z=0.1))
    assert stopping.add(rollout(True, z=0.2)) == "1 of 2 successes in a row"
    assert not stopping.complete and stopping.z.tolist() == [0.2, 1.0]
    stopping.add(rollout(True, z=0.2))
    assert stopping.complete


@pytest.mark.parametrize("failed", [rollout(False), rollout(True, note="barely")])
def test_a_failure_or_a_success_that_does_not_count_ends_the_row(failed: Record) -> None:
    stopping = rule(confirm=3)
    assert stopping.add(failed) == ""
    stopping.add(rollout(True))
    stopping.add(rollout(True))
    assert stopping.add(failed) == "ended after 2 successes in a row"
    assert (stopping.z, stopping.count) == (None, 0)
    assert stopping.add(rollout(True)) == "1 of 3 successes in a row"


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
