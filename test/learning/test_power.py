# SPDX-License-Identifier: Apache-2.0
"""PoWER [Kormushev2010, Eqs. 2-3], its shaped form, and corrections without it."""

import numpy as np
import pytest
from hill_task import SIZE, climb, hill, rng
from hypothesis import given, settings
from hypothesis import strategies as st

from wam_power_ros.learning.corrections_only import CorrectionsOnly
from wam_power_ros.learning.power import Power, power_update
from wam_power_ros.learning.shaped_power import ShapedPower


def history(seed: int, count: int = 20, size: int = 5) -> tuple[np.ndarray, np.ndarray]:
    source = rng(seed)
    return source.standard_normal((count, size)), source.uniform(0.1, 1.0, count)


@given(seed=st.integers(0, 10_000), sigma=st.integers(1, 30))
@settings(max_examples=30)
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
@settings(max_examples=30)
def test_the_order_of_past_rollouts_does_not_matter(weights: str, seed: int) -> None:
    rollouts, returns = history(seed)
    order = rng(seed + 1).permutation(len(returns))
    theta = np.zeros(5)
    np.testing.assert_array_equal(
        power_update(theta, rollouts, returns, 6, weights),
        power_update(theta, rollouts[order], returns[order], 6, weights),
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
    for weights in ("return", "sharpened"):
        updated = power_update(np.zeros(1), rollouts, np.ones(5), 2, weights)
        assert updated == pytest.approx(3.5)


@pytest.mark.parametrize(
    ("returns", "sigma", "reason"),
    [
        ([0.0, 0.0], 2, "none of 2 returns is positive"),
        ([1.0, -0.1], 2, r"finite and >= 0, got \[-0.1\]"),
        ([1.0, np.nan], 2, r"finite and >= 0, got \[nan\]"),
        ([1.0], 2, "must be"),
        ([1.0, 1.0], 0, "sigma is 0"),
    ],
)
def test_an_update_refuses_what_it_cannot_weight(
    returns: list[float], sigma: int, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        power_update(np.zeros(3), np.zeros((2, 3)), np.array(returns), sigma)


def test_without_a_positive_return_the_mean_stays_at_zero() -> None:
    learner = Power(3, Power.Settings(), rng(0))
    learner.tell(np.ones(3), 0.0)
    assert not learner.mean.any()
    learner.tell(2.0 * np.ones(3), 1e-300)
    np.testing.assert_array_equal(learner.mean, 2.0 * np.ones(3))


def test_a_mirrored_pair_is_symmetric_about_the_mean_it_was_sampled_about() -> None:
    learner = climb(ShapedPower(SIZE, ShapedPower.Settings(warm_up=4), rng(2)), 20)
    for ret in (1.0, 1.1, 1.2, 1.3):
        centre = learner.mean
        first = learner.ask()
        learner.tell(first, ret)
        second = learner.ask()
        np.testing.assert_allclose(second, 2.0 * centre - first, atol=1e-12)
        assert not np.array_equal(learner.mean, centre)
        learner.tell(second, ret)


def test_without_its_three_changes_it_is_power() -> None:
    settings = ShapedPower.Settings(sigma=6, weights="return", decay=1.0, warm_up=0, mirrored=False)
    plain = climb(Power(SIZE, Power.Settings(), rng(3)), 40)
    np.testing.assert_allclose(
        climb(ShapedPower(SIZE, settings, rng(3)), 40).mean, plain.mean, rtol=1e-9, atol=1e-12
    )


def test_the_noise_decays_with_every_rollout_after_the_warm_up() -> None:
    settings = ShapedPower.Settings(warm_up=4, decay=0.5, mirrored=False)
    learner, source = ShapedPower(SIZE, settings, rng(6)), rng(6)
    for noise in (1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.25):
        z = learner.ask()
        np.testing.assert_array_equal(z, learner.mean + noise * source.standard_normal(SIZE))
        learner.tell(z, hill(z))


def test_rank_weights_are_those_of_the_formula_however_few_the_rollouts() -> None:
    z, returns = rng(1).standard_normal((4, SIZE)), np.array([0.1, 0.9, 0.4, 0.2])
    learner = ShapedPower(SIZE, ShapedPower.Settings(sigma=3, warm_up=0, mirrored=False), rng(0))
    for count in range(1, 5):
        learner.tell(z[count - 1], float(returns[count - 1]))
        best = np.argsort(-returns[:count])[:3]
        weights = np.log(3.5) - np.log(np.arange(1, len(best) + 1))
        np.testing.assert_allclose(learner.mean, np.average(z[best], axis=0, weights=weights))


def test_the_last_corrected_rollout_is_tried_next_whatever_its_return() -> None:
    learner = CorrectionsOnly(SIZE, CorrectionsOnly.Settings(), rng(0))
    assert not learner.ask().any()  # the reproduction, as it was demonstrated
    for value, ret in ((0.5, 1.0), (1.0, 0.0)):
        learner.tell(np.full(SIZE, value), ret)
        assert learner.ask().tolist() == learner.mean.tolist() == [value] * SIZE


def test_it_draws_nothing() -> None:
    source = rng(0)
    CorrectionsOnly(SIZE, CorrectionsOnly.Settings(), source).ask()
    assert source.random() == rng(0).random()
