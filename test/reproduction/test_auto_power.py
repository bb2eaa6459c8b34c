# SPDX-License-Identifier: Apache-2.0
"""PoWER with an elite of automatic size."""

import numpy as np
from hill_task import rng
from hypothesis import given, settings
from hypothesis import strategies as st

from reproduction.rivals.learners import SIGMAS, AutoPower, choose_sigma
from wam_power_ros.learning.power import power_update


def searched(seed: int, noise: float, count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Rollouts about zero in 12 dimensions, and noisy returns that are linear in them."""
    generator = rng(seed)
    z = generator.standard_normal((count, 12))
    ret = np.exp(0.3 * z[:, 0]) + noise * generator.standard_normal(count)
    return z, np.maximum(ret, 0.0)


def test_the_elite_is_larger_where_returns_are_noisy() -> None:
    def mean_size(noise: float) -> float:
        return float(np.mean([choose_sigma(*searched(seed, noise)) for seed in range(30)]))

    assert 1.3 * mean_size(0.0) < mean_size(1.0)


def test_without_a_positive_gain_the_elite_has_the_size_of_the_paper() -> None:
    z, ret = searched(0, 0.1)
    with np.errstate(all="raise"):  # no division by zero
        assert choose_sigma(z[:7], ret[:7]) == 6
        assert choose_sigma(z, np.zeros(60)) == 6
        assert choose_sigma(z, np.ones(60)) == 6
        assert choose_sigma(np.zeros((60, 12)), ret) == 6


@given(seed=st.integers(0, 10_000))
@settings(deadline=None)
def test_the_mean_is_that_of_the_chosen_elite(seed: int) -> None:
    learner = AutoPower(4, AutoPower.Settings(), rng(seed))
    rollouts, returns = [], []
    for _ in range(12):
        rollouts.append(learner.ask())
        returns.append(float(np.exp(-rollouts[-1] @ rollouts[-1])))
        learner.tell(rollouts[-1], returns[-1])
    z, ret = np.array(rollouts), np.array(returns)
    assert learner.sigma == choose_sigma(z, ret)
    np.testing.assert_array_equal(learner.mean, power_update(np.zeros(4), z, ret, learner.sigma))


def test_the_elite_is_chosen_from_eight_sizes_by_the_gain_at_every_number_of_rollouts() -> None:
    assert SIGMAS == (2, 3, 4, 6, 8, 12, 16, 24)
    chosen = set()
    for seed in range(16):
        for count in (8, 10, 13, 30):
            z, ret = searched(seed, 0.5, count)
            gains = {size: _gain(z, ret, size) for size in SIGMAS if size < count - 1}
            best = max(gains, key=gains.get)
            assert choose_sigma(z, ret) == (best if gains[best] > 0.0 else 6)
            chosen.add(best)
    assert chosen == set(SIGMAS)


def test_an_elite_of_all_the_others_is_not_chosen_even_if_its_gain_is_the_largest() -> None:
    tempting = 0
    for seed in range(400):
        z, ret = searched(seed, 2.0, 9)
        gains = {size: _gain(z, ret, size) for size in SIGMAS if size <= 8}
        tempting += gains[8] > 0.0 and max(gains, key=gains.get) == 8
        assert choose_sigma(z, ret) != 8
    assert tempting > 2


def _gain(z: np.ndarray, ret: np.ndarray, size: int) -> float:
    lengths, along = [], []
    for k in range(len(z)):
        others = np.delete(np.arange(len(z)), k)
        centre = z[others].mean(axis=0)
        step = power_update(np.zeros(z.shape[1]), z[others], ret[others], size) - centre
        lengths.append(np.linalg.norm(step))
        along.append((z[k] - centre) @ step / lengths[-1])
    return float(np.mean(lengths) * np.cov(along, ret)[0, 1] / np.var(along, ddof=1))


def test_a_size_whose_elite_may_have_earned_nothing_is_left_out() -> None:
    z, ret = searched(3, 0.2, 12)
    few = np.where(np.arange(12) < 2, ret + 0.1, 0.0)  # one remains when the other is left out
    assert choose_sigma(z, few) in SIGMAS
    alone = np.where(np.arange(12) < 1, ret + 0.1, 0.0)  # without it, no return is positive
    assert choose_sigma(z, alone) == 6
