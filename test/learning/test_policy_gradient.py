# SPDX-License-Identifier: Apache-2.0
"""REINFORCE and the natural actor-critic."""

import numpy as np
import pytest
from hill_task import rng

from wam_power_ros.learning.policy_gradient import Enac, Reinforce

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
