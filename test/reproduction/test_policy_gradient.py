# SPDX-License-Identifier: Apache-2.0
"""REINFORCE and the natural actor-critic."""

from collections.abc import Callable

import numpy as np
import pytest
from hill_task import rng

from reproduction.rivals.learners import Enac, Reinforce

SLOPE = np.array([3.0, -1.0, 0.5])


def cosine_after(learner: Enac | Reinforce, rollouts: int) -> float:
    """Cosine between the step of a learner and the gradient of a linear return."""
    for _ in range(rollouts):
        z = learner.ask()
        learner.tell(z, 50.0 + float(SLOPE @ z))
    return SLOPE @ learner.mean / np.linalg.norm(SLOPE) / np.linalg.norm(learner.mean)


def test_the_natural_gradient_of_a_linear_return_is_exact() -> None:
    learner = Enac(3, Enac.Settings(population=10), rng(0))
    assert cosine_after(learner, 10) == pytest.approx(1.0, abs=1e-9)


def test_reinforce_estimates_the_gradient_of_a_linear_return() -> None:
    learner = Reinforce(3, Reinforce.Settings(population=500), rng(0))
    assert cosine_after(learner, 500) > 0.95


@pytest.mark.parametrize("found", [Reinforce, Enac])
def test_a_step_is_proportional_to_the_rate(found: type[Reinforce] | type[Enac]) -> None:
    means = []
    for rate in (1.0, 0.25):
        learner = found(3, found.Settings(population=10, rate=rate), rng(1))
        cosine_after(learner, 10)
        means.append(learner.mean)
    np.testing.assert_allclose(means[1], 0.25 * means[0])


def reinforce(eps: np.ndarray, returns: np.ndarray) -> np.ndarray:
    """Gradient with a minimum-variance baseline per axis [Peters2008]."""
    gradient = []
    for column in eps.T:
        baseline = sum(column**2 * returns) / sum(column**2)
        gradient.append(np.mean([e * (r - baseline) for e, r in zip(column, returns, strict=True)]))
    return np.array(gradient)


def natural(eps: np.ndarray, returns: np.ndarray) -> np.ndarray:
    """Natural gradient: least squares of the returns in psi and a constant [Peters2008]."""
    return np.linalg.lstsq(np.column_stack([eps, np.ones(len(eps))]), returns, rcond=None)[0][:-1]


@pytest.mark.parametrize(("found", "formula"), [(Reinforce, reinforce), (Enac, natural)])
def test_every_step_is_that_of_the_formula_in_units_of_the_noise(
    found: type[Reinforce] | type[Enac], formula: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> None:
    learner = found(3, found.Settings(population=6, rate=0.7, decay=0.5), rng(2))
    mean, noise = np.zeros(3), 1.0
    for _ in range(3):
        z = [learner.ask() for _ in range(6)]
        returns = np.array([0.02 * np.exp(-np.sum((one - 0.3) ** 2)) for one in z])
        for one, ret in zip(z, returns, strict=True):
            learner.tell(one, float(ret))
        eps = (np.array(z) - mean) / noise
        mean = mean + 0.7 * noise * formula(eps, (returns - returns.mean()) / returns.std())
        noise *= 0.5
        np.testing.assert_allclose(learner.mean, mean, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("found", [Reinforce, Enac])
def test_a_population_of_equal_returns_leaves_the_mean(
    found: type[Reinforce] | type[Enac],
) -> None:
    learner = found(3, found.Settings(population=4), rng(0))
    for _ in range(4):
        learner.tell(learner.ask(), 0.5)
    assert not learner.mean.any()
