# SPDX-License-Identifier: Apache-2.0
"""PoWER [Kormushev2010, Eqs. 2-3]: update, ask and tell."""

import numpy as np
import pytest
from hill_task import rng
from hypothesis import given, settings
from hypothesis import strategies as st

from wam_power_ros.learning.power import Power, power_update


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


@pytest.mark.parametrize("weights", ["return", "sharpened"])
@pytest.mark.parametrize("factor", [1e-300, 1.7e308])
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
    for weights in ("return", "sharpened"):
        updated = power_update(np.zeros(1), rollouts, np.ones(5), 2, weights)
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
