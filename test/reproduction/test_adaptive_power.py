# SPDX-License-Identifier: Apache-2.0
"""PoWER that adapts the exploration variance."""

import numpy as np
from hill_task import SIZE, rng

from reproduction.rivals.learners import AdaptivePower


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
