# SPDX-License-Identifier: Apache-2.0
"""Learners that others use, beside the package's own."""

import numpy as np
from hill_task import SIZE, climb, hill, rng

from reproduction.rivals.learners import AdaptivePower, BayesianOptimization, Pi2, RandomSearch


def variance(settings: AdaptivePower.Settings, rollouts: list[np.ndarray]) -> np.ndarray:
    """Variance of the samples drawn after these rollouts."""
    learner = AdaptivePower(SIZE, settings, rng(0))
    for z in rollouts:
        learner.tell(z, 1.0)
    return np.stack([learner.ask() for _ in range(2000)]).var(axis=0)


def test_the_variance_stays_within_its_bounds() -> None:
    settings = AdaptivePower.Settings(sigma=1, variance_sigma=1)
    np.testing.assert_allclose(variance(settings, [np.zeros(SIZE)] * 2), 0.1, rtol=0.2)
    settings = AdaptivePower.Settings(sigma=2, largest=4.0)
    far = 100.0 * np.ones(SIZE)
    np.testing.assert_allclose(variance(settings, [far, -far]), 4.0, rtol=0.2)


def test_each_parameter_gets_the_variance_of_its_own_rollouts() -> None:
    spread = np.array([0.5, 1.0, 2.0, 0.5, 1.0, 2.0])
    settings = AdaptivePower.Settings(sigma=2)
    # about the mean before the last update, which was the first rollout: (0 + (2 spread)^2) / 2
    expected = 2.0 * spread**2
    for second in (-spread, 3.0 * spread):
        np.testing.assert_allclose(variance(settings, [spread, second]), expected, rtol=0.2)


def test_the_variance_is_weighted_by_returns_of_any_size_zero_included() -> None:
    settings = AdaptivePower.Settings(sigma=1, largest=1e3)
    for scale in (1.0, 2.0**-600):
        learner = AdaptivePower(SIZE, settings, rng(0))
        for z, ret in ((0.0, 0.5), (3.0, 1.0), (9.0, 0.0)):
            learner.tell(np.full(SIZE, z), scale * ret)
        # about the best one at 3, which was the mean already: (0.5 * 3^2 + 1 * 0 + 0 * 6^2) / 1.5
        samples = np.stack([learner.ask() for _ in range(2000)])
        np.testing.assert_allclose(samples.var(axis=0), 3.0, rtol=0.2)


TOP = np.array([3.0, -2.0, *np.zeros(SIZE - 2)])


class Directions:
    """An error model of which only the directions are used."""

    directions = 5.0 * np.eye(2, SIZE)
    slopes = np.zeros((1, 2))

    def predict(self, z: np.ndarray) -> None:
        """Fail."""
        raise AssertionError("the model is not asked")


def optimizer(seed: int) -> BayesianOptimization:
    return BayesianOptimization(SIZE, BayesianOptimization.Settings(), rng(seed), Directions())


def hilly(z: np.ndarray) -> float:
    return float(np.exp(-0.1 * ((z - TOP) ** 2).sum()))


def practised(learner: BayesianOptimization, rollouts: int) -> BayesianOptimization:
    learner.tell(np.zeros(SIZE), hilly(np.zeros(SIZE)))
    for _ in range(rollouts):
        z = learner.ask()
        learner.tell(z, hilly(z))
    return learner


def test_bayesian_optimization_finds_the_top_along_the_directions_within_the_bound() -> None:
    assert hilly(np.zeros(SIZE)) < 0.3
    learner = practised(optimizer(0), 30)
    assert hilly(learner.mean) > 0.95
    asked = np.stack([learner.ask() for _ in range(10)])
    assert not asked[:, 2:].any()
    assert np.abs(asked).max() <= 2.0 * 5.0


def test_the_mean_is_the_rollout_of_highest_expected_return_not_the_luckiest() -> None:
    learner = optimizer(0)
    for k, x in enumerate(np.linspace(-2.0, 2.0, 21)):
        z = 5.0 * x * np.eye(SIZE)[0]
        lucky = 0.6 if k == 3 else 0.0
        learner.tell(z, float(np.exp(-((x - 1.0) ** 2))) * 0.5 + lucky)
    assert abs(learner.mean[0] / 5.0 - 1.0) < 0.4


def test_the_seed_decides_and_the_same_rollouts_restore_it() -> None:
    first, second = practised(optimizer(2), 8), optimizer(2)
    for z, value in zip(first._rollouts.z, first._rollouts.returns, strict=True):
        if z.any():
            second.ask()
        second.tell(z, float(value))
    np.testing.assert_array_equal(first.mean, second.mean)
    np.testing.assert_array_equal(first.ask(), second.ask())


def test_the_mean_moves_once_a_population_and_the_noise_decays_with_it() -> None:
    settings = Pi2.Settings(population=4, decay=0.5)
    learner = climb(Pi2(SIZE, settings, rng(0)), 3)
    assert not learner.mean.any()
    mean = climb(learner, 1).mean
    assert mean.any()
    source = rng(0)
    source.standard_normal((4, SIZE))
    np.testing.assert_array_equal(learner.ask(), mean + 0.5 * source.standard_normal(SIZE))


def test_the_weights_are_those_of_the_formula() -> None:
    z, returns = rng(1).standard_normal((5, SIZE)), np.array([0.1, 0.9, 0.4, 0.2, 0.6])
    learner = Pi2(SIZE, Pi2.Settings(population=5, eliteness=3.0), rng(0))
    for offset in (0.0, 1000.0):  # a level that all returns share does not matter
        for one, ret in zip(z + offset, returns + offset, strict=True):
            learner.tell(one, float(ret))
        weights = np.exp(3.0 * (returns - 0.9) / 0.8)
        np.testing.assert_allclose(learner.mean, np.average(z, axis=0, weights=weights) + offset)


def test_random_search_keeps_the_best_rollout() -> None:
    learner = RandomSearch(SIZE, RandomSearch.Settings(), rng(0))
    assert not learner.mean.any()
    samples = [learner.ask() for _ in range(50)]
    for z in samples:
        learner.tell(z, hill(z))
    np.testing.assert_array_equal(learner.mean, max(samples, key=hill))
