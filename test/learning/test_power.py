# SPDX-License-Identifier: Apache-2.0
"""PoWER [Kormushev2010, Eqs. 2-3]: update, choice of sigma, ask and tell."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wam_power_ros.learning.power import (
    SIGMAS,
    Power,
    choose_sigma,
    power_update,
)


def rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def history(seed: int, count: int = 20, size: int = 5) -> tuple[np.ndarray, np.ndarray]:
    source = rng(seed)
    return source.standard_normal((count, size)), source.uniform(0.1, 1.0, count)


@given(seed=st.integers(0, 10_000), sigma=st.integers(1, 30))
@settings(deadline=None)
def test_the_current_parameters_cancel_and_leave_the_weighted_mean_of_the_elite(
    seed: int, sigma: int
) -> None:
    rollouts, returns = history(seed)
    theta = 10.0 * rng(seed + 1).standard_normal(5)
    best = np.argsort(returns)[-sigma:]
    expected = np.average(rollouts[best], axis=0, weights=returns[best])
    updated = power_update(theta, rollouts, returns, sigma)
    np.testing.assert_allclose(updated, expected, atol=1e-12)


@pytest.mark.parametrize("weights", ["return", "sharpened"])
@given(seed=st.integers(0, 10_000))
@settings(deadline=None)
def test_the_order_of_past_rollouts_does_not_matter(weights: str, seed: int) -> None:
    rollouts, returns = history(seed)
    order = rng(seed + 1).permutation(len(returns))
    theta = np.zeros(5)
    np.testing.assert_array_equal(
        power_update(theta, rollouts, returns, 6, weights),
        power_update(theta, rollouts[order], returns[order], 6, weights),
    )


@pytest.mark.parametrize("weights", ["return", "sharpened"])
@pytest.mark.parametrize("factor", [1e-300, 1e-12, 3.0, 1.7e308])
def test_scaling_all_returns_leaves_the_update(weights: str, factor: float) -> None:
    rollouts, returns = history(3)
    np.testing.assert_allclose(
        power_update(np.zeros(5), rollouts, factor * returns, 6, weights),
        power_update(np.zeros(5), rollouts, returns, 6, weights),
        rtol=1e-9,
    )


def test_sharpened_weights_are_those_of_the_formula() -> None:
    rollouts, returns = history(4)
    best = np.argsort(returns)[-6:]
    r = returns[best]
    weight = np.exp((r - r.max()) / (0.3 * (r.max() - r.min())))
    for sharpness in ((), (0.3,)):  # the default
        np.testing.assert_allclose(
            power_update(np.zeros(5), rollouts, returns, 6, "sharpened", *sharpness),
            np.average(rollouts[best], axis=0, weights=weight),
        )


def test_of_equal_returns_the_later_rollouts_make_the_elite() -> None:
    rollouts = np.arange(5.0)[:, np.newaxis]
    updated = power_update(np.zeros(1), rollouts, np.ones(5), 2)
    assert updated == pytest.approx(3.5)
    updated = power_update(np.zeros(1), rollouts, np.ones(5), 2, "sharpened")
    assert updated == pytest.approx(3.5)


def test_the_arguments_of_an_update_are_not_modified() -> None:
    rollouts, returns = history(5)
    theta = np.ones(5)
    for array in (rollouts, returns, theta):
        array.setflags(write=False)
    power_update(theta, rollouts, returns, 6)


@pytest.mark.parametrize(
    ("returns", "sigma", "reason"),
    [
        ([0.0, 0.0], 2, "none of 2 returns is positive"),
        ([1.0, -0.1], 2, r"finite and >= 0, got \[-0.1\]"),
        ([1.0, np.nan], 2, r"finite and >= 0, got \[nan\]"),
        ([1.0, np.inf], 2, r"finite and >= 0, got \[inf\]"),
        ([1.0], 2, "must be"),
        ([], 2, "must be"),
        ([1.0, 1.0], 0, "sigma is 0"),
    ],
)
def test_an_update_refuses_what_it_cannot_weight(
    returns: list[float], sigma: int, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        power_update(np.zeros(3), np.zeros((2, 3)), np.array(returns), sigma)


@pytest.mark.parametrize("weights", ["return", "sharpened"])
def test_power_climbs_a_hill_from_every_seed(weights: str) -> None:
    size, top = 10, 2.0 * np.ones(10) / np.sqrt(10.0)  # two standard deviations away
    final = []
    for seed in range(20):
        learner = Power(size, Power.Settings(weights=weights, sigma=5, decay=0.98), rng(seed))
        for _ in range(150):
            z = learner.ask()
            learner.tell(z, float(np.exp(-np.sum((z - top) ** 2))))
        final.append(np.linalg.norm(learner.mean - top))
    assert max(final) < 1.2
    assert np.mean(final) < 0.8


def test_without_a_positive_return_the_mean_stays_at_zero() -> None:
    learner = Power(3, Power.Settings(), rng(0))
    learner.tell(np.ones(3), 0.0)
    assert not learner.mean.any()
    learner.tell(2.0 * np.ones(3), 1e-300)
    np.testing.assert_array_equal(learner.mean, 2.0 * np.ones(3))


def test_noise_shrinks_with_every_rollout() -> None:
    learner = Power(2, Power.Settings(decay=0.9), rng(0))
    for _ in range(3):
        learner.tell(learner.ask(), 1.0)
    assert learner._noise == pytest.approx(0.9**3)
    assert len(learner._rollouts) == 3


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
    learner = Power(4, Power.Settings(sigma="auto"), rng(seed))
    rollouts, returns = [], []
    for _ in range(12):
        rollouts.append(learner.ask())
        returns.append(float(np.exp(-rollouts[-1] @ rollouts[-1])))
        learner.tell(rollouts[-1], returns[-1])
    z, ret = np.array(rollouts), np.array(returns)
    assert learner.sigma == choose_sigma(z, ret)
    np.testing.assert_array_equal(learner.mean, power_update(np.zeros(4), z, ret, learner.sigma))


def test_the_size_of_an_elite_is_a_positive_integer_or_auto() -> None:
    for sigma in (0, "large", 2.5):
        with pytest.raises(ValueError, match="sigma"):
            Power.Settings(sigma=sigma)


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


def test_weights_that_do_not_exist_are_refused() -> None:
    with pytest.raises(ValueError, match="'rank' is not one of return, sharpened"):
        power_update(np.zeros(5), *history(0), 6, "rank")
