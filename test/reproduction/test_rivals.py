# SPDX-License-Identifier: Apache-2.0
"""Learners that others use, beside the package's own."""

import numpy as np
from hill_task import SIZE, climb, hill, rng

from reproduction.rivals.learners import AdaptivePower, Pi2, RandomSearch


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
