# SPDX-License-Identifier: Apache-2.0
"""Properties of every learner."""

from typing import Any

import numpy as np
import pytest
from hill_task import SIZE, climb, hill, rng
from hypothesis import given, settings
from hypothesis import strategies as st

from reproduction.rivals.learners import Pi2, RandomSearch
from wam_power_ros.learning.cma_es import CmaEs
from wam_power_ros.learning.learner import (
    Learner,
    LearnerClass,
    Rollouts,
    best_first,
    generator_state,
)
from wam_power_ros.learning.power import Power
from wam_power_ros.learning.shaped_power import ShapedPower

CLIMBERS: list[tuple[LearnerClass, dict[str, Any]]] = [
    (Power, {}),
    (ShapedPower, {}),
    (ShapedPower, {"weights": "return", "mirrored": False}),
    (Pi2, {}),
    (CmaEs, {}),
]
ALL = [*CLIMBERS, (RandomSearch, {})]
every_learner = pytest.mark.parametrize(("found", "values"), ALL)


def started(found: LearnerClass, values: dict[str, Any], seed: int) -> Learner:
    return found(SIZE, found.Settings(**values), rng(seed))


@pytest.mark.parametrize(("found", "values"), CLIMBERS)
def test_every_learner_climbs_a_hill(found: LearnerClass, values: dict[str, Any]) -> None:
    learner = climb(started(found, values, 0), 300)
    assert hill(np.zeros(SIZE)) < 0.32
    assert hill(learner.mean) > 0.6


@every_learner
def test_exploration_starts_about_zero_with_unit_variance_and_never_repeats(
    found: LearnerClass, values: dict[str, Any]
) -> None:
    learner = started(found, values, 0)
    samples = np.stack([learner.ask() for _ in range(500)])
    assert not learner.mean.any()
    np.testing.assert_allclose(samples.mean(axis=0), 0.0, atol=0.2)
    np.testing.assert_allclose(samples.std(axis=0), 1.0, atol=0.15)
    assert len(np.unique(samples[:, 0])) == 500


@pytest.mark.parametrize("found", [Pi2, CmaEs])
def test_each_population_moves_the_mean_once_and_the_next_begins_anew(found: LearnerClass) -> None:
    learner = started(found, {"population": 7}, 0)
    means = [learner.mean, *(climb(learner, 1).mean for _ in range(21))]
    moved = [k for k in range(1, 22) if not np.array_equal(means[k], means[k - 1])]
    assert moved == [7, 14, 21]


@every_learner
def test_rollouts_that_earned_nothing_do_not_stop_the_learning(
    found: LearnerClass, values: dict[str, Any]
) -> None:
    learner = started(found, values, 0)
    for _ in range(40):
        learner.tell(learner.ask(), 0.0)
    if found not in (CmaEs, RandomSearch):  # these use only the order of the returns
        assert not learner.mean.any()
    assert climb(learner, 60).mean.any() and np.isfinite(learner.mean).all()


@every_learner
def test_a_learner_given_the_same_rollouts_goes_on_bit_for_bit(
    found: LearnerClass, values: dict[str, Any]
) -> None:
    learner, again = started(found, values, 1), started(found, values, 1)
    for _ in range(33):
        z = learner.ask()
        again.ask()  # a resumed session repeats the draws of its log
        learner.tell(z, hill(z))
        again.tell(z, hill(z))
    for _ in range(25):
        z = learner.ask()
        np.testing.assert_array_equal(again.ask(), z)
        learner.tell(z, hill(z))
        again.tell(z, hill(z))
        np.testing.assert_array_equal(again.mean, learner.mean)


@every_learner
def test_the_seed_decides_and_tell_draws_nothing(
    found: LearnerClass, values: dict[str, Any]
) -> None:
    source = rng(4)
    first = climb(found(SIZE, found.Settings(**values), source), 30)
    second, other = (climb(started(found, values, seed), 30) for seed in (4, 5))
    np.testing.assert_array_equal(first.mean, second.mean)
    assert not np.array_equal(second.mean, other.mean)
    before = generator_state(source)
    first.tell(np.ones(SIZE), 0.5)
    assert generator_state(source) == before


@every_learner
def test_a_rollout_that_cannot_be_learnt_from_is_refused_and_changes_nothing(
    found: LearnerClass, values: dict[str, Any]
) -> None:
    learner, untouched = (climb(started(found, values, 0), 5) for _ in range(2))
    for z, ret in [
        (np.zeros(SIZE + 1), 1.0),
        (np.array([np.nan, *np.zeros(SIZE - 1)]), 1.0),
        (np.zeros(SIZE), -0.1),
        (np.zeros(SIZE), np.nan),
    ]:
        with pytest.raises(ValueError, match="must be finite"):
            learner.tell(z, ret)
    for _ in range(20):
        np.testing.assert_array_equal(climb(learner, 1).mean, climb(untouched, 1).mean)


@every_learner
def test_a_learner_without_parameters_or_with_an_unused_model_is_refused(
    found: LearnerClass, values: dict[str, Any]
) -> None:
    least = found.size_min
    with pytest.raises(ValueError, match="size is 0"):
        found(0, found.Settings(), rng(0))
    assert found(least, found.Settings(), rng(0)).ask().shape == (least,)
    assert least == (2 if found is CmaEs else 1)
    with pytest.raises(ValueError, match="model"):
        found(SIZE, found.Settings(), rng(0), object())


@settings(max_examples=30)
@given(
    returns=st.lists(st.sampled_from([0.0, 0.25, 0.5, 1.0]), min_size=1, max_size=40),
    sigma=st.integers(1, 12),
)
def test_the_elite_is_that_of_all_rollouts_at_any_number_of_them(
    returns: list[float], sigma: int
) -> None:
    assert best_first(np.array([0.2, 0.9, 0.2, 0.9, 0.1])).tolist() == [3, 1, 2, 0, 4]
    rollouts = Rollouts(1)
    for count, ret in enumerate(returns, start=1):
        rollouts.add(np.array([float(count)]), ret)
        past = np.array(returns[:count])
        expected = np.sort(best_first(past)[:sigma])
        z, elite = rollouts.elite(sigma)
        assert z.ravel().tolist() == (expected + 1.0).tolist()
        assert elite.tolist() == past[expected].tolist()
        assert rollouts.z.ravel().tolist() == list(range(1, count + 1))


def test_past_rollouts_cannot_be_changed_by_who_reads_them() -> None:
    rollouts, told = Rollouts(2), np.ones(2)
    rollouts.add(told, 0.5)
    told[0] = 9.0
    for kept in (rollouts.z, rollouts.returns):
        with pytest.raises(ValueError, match="read-only"):
            kept[0] = 7.0
    assert rollouts.z.tolist() == [[1.0, 1.0]]


def test_the_state_of_a_generator_restores_it_and_other_generators_are_refused() -> None:
    source = rng(0)
    source.standard_normal(3)
    other = np.random.PCG64()
    other.state = generator_state(source)
    assert np.random.Generator(other).random() == source.random()
    with pytest.raises(ValueError, match="PCG64"):
        generator_state(np.random.Generator(np.random.MT19937(0)))
