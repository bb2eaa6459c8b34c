# SPDX-License-Identifier: Apache-2.0
"""Reaching around an obstacle: stopped paths, learners, and the arm (Sec. III-A, Eq. 4)."""

import numpy as np
import pytest

from reproduction.rivals.reach_model import ReachModel
from reproduction.studies.reaching import NOISE, study
from reproduction.studies.reaching_scenario import RADIUS, synthetic
from wam_power_ros.learning.dmp import activations
from wam_power_ros.learning.parametrization import parametrization_of
from wam_power_ros.learning.policy import Policy
from wam_power_ros.tasks.reach.paths import STEPS

SCENARIO = synthetic()
FULL = parametrization_of(SCENARIO.policy, "full", NOISE["full"])


def evaluated(policy: Policy) -> float:
    """Return of a policy (Eq. 4)."""
    ret, _ = SCENARIO.evaluate(policy.stiffness[np.newaxis], policy.attractors[np.newaxis])
    return float(ret[0])


@pytest.mark.parametrize("variant", ["full", "diagonal"])
def test_power_gets_far_beyond_the_demonstration(variant: str) -> None:
    start = evaluated(SCENARIO.policy)
    final = [run.final for run in study(variant, range(5), 60)]
    assert np.mean(final) > start + 0.15


def drawn(count: int, seed: int = 0) -> list[Policy]:
    rng = np.random.default_rng(seed)
    return [FULL.policy(3.0 * rng.standard_normal(24), f"p{k}")[0] for k in range(count)]


def plain_path(policy: Policy) -> np.ndarray:
    """Path of Eq. 1 without the obstacle [m], computed literally, step by step. Shape (T, 3)."""
    h = activations(policy.basis, np.arange(STEPS - 1) * SCENARIO.period)
    x, xd = np.array(SCENARIO.start), np.zeros(3)
    path = [x]
    for weights in h:
        xdd = -policy.damping * xd
        for weight, stiffness, mu in zip(weights, policy.stiffness, policy.attractors, strict=True):
            xdd = xdd + weight * (stiffness @ (mu - x))
        xd = xd + SCENARIO.period * xdd
        x = x + SCENARIO.period * xd
        path.append(x)
    return np.stack(path)


def arrays(policies: list[Policy]) -> tuple[np.ndarray, np.ndarray]:
    return (
        np.stack([policy.stiffness for policy in policies]),
        np.stack([policy.attractors for policy in policies]),
    )


def paths(policies: list[Policy]) -> tuple[np.ndarray, np.ndarray]:
    return SCENARIO.stopped_paths(SCENARIO.free_paths(*arrays(policies)))


def test_no_sample_of_a_path_is_inside_the_obstacle() -> None:
    path, _ = paths(drawn(50))
    distance = np.linalg.norm(path - SCENARIO.obstacle, axis=-1)
    assert distance.min() >= RADIUS


def test_a_path_that_jumps_over_the_obstacle_between_two_samples_collides() -> None:
    side = np.where(np.arange(200) < 100, -0.2, 0.2)
    path = SCENARIO.obstacle + np.outer(side, [1.0, 0.0, 0.0])
    stopped, collided = SCENARIO.stopped_paths(path[None])
    assert collided[0]
    np.testing.assert_array_equal(stopped[0], np.tile(path[0], (200, 1)))


def test_a_return_is_that_of_the_policy_alone_and_of_equation_1_as_written() -> None:
    policies = drawn(8)
    returns, collided = SCENARIO.evaluate(*arrays(policies))
    alone = [SCENARIO.evaluate(*arrays([policy]))[0][0] for policy in policies]
    np.testing.assert_allclose(returns, alone, rtol=1e-9)
    plain = np.stack([plain_path(policy) for policy in policies])
    path, plain_collided = SCENARIO.stopped_paths(plain)
    np.testing.assert_allclose(path, paths(policies)[0], atol=1e-9)
    np.testing.assert_array_equal(collided, plain_collided)


def test_a_model_predicts_a_free_path_exactly_and_a_stopped_one_better_each_time() -> None:
    model = ReachModel(FULL, SCENARIO)
    z = np.random.default_rng(3).standard_normal((300, FULL.size)) * 6.0
    stiffness, attractors, _ = FULL.arrays(z)
    returns, collided = SCENARIO.evaluate(stiffness, attractors)
    assert 20 < collided.sum() < 280
    np.testing.assert_allclose(model.predict(z[~collided]), returns[~collided], rtol=1e-9)
    before = np.abs(model.predict(z) - returns)[200:].mean()
    for one, ret in zip(z[:200], returns[:200], strict=True):
        model.learn(one, float(ret))
    assert np.abs(model.predict(z) - returns)[200:].mean() < 0.7 * before
