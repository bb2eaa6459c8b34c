# SPDX-License-Identifier: Apache-2.0
"""Bayesian optimisation along the directions of an error model."""

import numpy as np
from hill_task import rng

from reproduction.rivals.learners import BayesianOptimization

SIZE = 6
TOP = np.array([3.0, -2.0, 0.0, 0.0, 0.0, 0.0])


class Directions:
    """An error model of which only the directions are used."""

    directions = 5.0 * np.eye(2, SIZE)
    slopes = np.zeros((1, 2))

    def predict(self, z: np.ndarray) -> None:
        """Fail."""
        raise AssertionError("the model is not asked")


def learner_of(seed: int) -> BayesianOptimization:
    return BayesianOptimization(SIZE, BayesianOptimization.Settings(), rng(seed), Directions())


def ret(z: np.ndarray) -> float:
    return float(np.exp(-0.1 * ((z - TOP) ** 2).sum()))


def practised(learner: BayesianOptimization, rollouts: int) -> BayesianOptimization:
    learner.tell(np.zeros(SIZE), ret(np.zeros(SIZE)))
    for _ in range(rollouts):
        z = learner.ask()
        learner.tell(z, ret(z))
    return learner


def test_it_finds_the_top_in_thirty_rollouts() -> None:
    assert ret(np.zeros(SIZE)) < 0.3
    assert ret(practised(learner_of(0), 30).mean) > 0.95


def test_it_stays_along_the_directions_and_within_the_bound() -> None:
    learner = practised(learner_of(1), 10)
    asked = np.stack([learner.ask() for _ in range(20)])
    assert not asked[:, 2:].any()
    assert np.abs(asked).max() <= 2.0 * 5.0


def test_the_mean_is_the_rollout_of_highest_expected_return_not_the_luckiest() -> None:
    learner = learner_of(0)
    for k, x in enumerate(np.linspace(-2.0, 2.0, 21)):
        z = 5.0 * x * np.eye(SIZE)[0]
        lucky = 0.6 if k == 3 else 0.0
        learner.tell(z, float(np.exp(-((x - 1.0) ** 2))) * 0.5 + lucky)
    assert abs(learner.mean[0] / 5.0 - 1.0) < 0.4


def test_the_seed_decides_and_the_same_rollouts_restore_it() -> None:
    first, second = practised(learner_of(2), 8), learner_of(2)
    for z, value in zip(first._rollouts.z, first._rollouts.returns, strict=True):
        if z.any():
            second.ask()
        second.tell(z, float(value))
    np.testing.assert_array_equal(first.mean, second.mean)
    np.testing.assert_array_equal(first.ask(), second.ask())
