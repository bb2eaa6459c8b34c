# SPDX-License-Identifier: Apache-2.0
"""PoWER with a warm-up, rank weights and mirrored sampling."""

import numpy as np
from hill_task import SIZE, climb, hill, rng

from wam_power_ros.learning.power import Power
from wam_power_ros.learning.shaped_power import ShapedPower


def test_a_mirrored_pair_is_symmetric_about_the_mean_it_was_sampled_about() -> None:
    learner = climb(ShapedPower(SIZE, ShapedPower.Settings(warm_up=4), rng(2)), 20)
    centre = learner.mean
    first = learner.ask()
    learner.tell(first, 1.0)
    np.testing.assert_allclose(learner.ask(), 2.0 * centre - first, atol=1e-12)


def test_the_mean_stays_during_the_warm_up() -> None:
    learner = ShapedPower(SIZE, ShapedPower.Settings(warm_up=10), rng(0))
    np.testing.assert_array_equal(climb(learner, 9).mean, np.zeros(SIZE))
    assert climb(learner, 1).mean.any()


def test_rank_weights_depend_only_on_the_order_of_returns() -> None:
    first, second = (ShapedPower(SIZE, ShapedPower.Settings(), rng(0)) for _ in range(2))
    for _ in range(30):
        for learner, power in ((first, 1.0), (second, 3.0)):
            z = learner.ask()
            learner.tell(z, hill(z) ** power)
    np.testing.assert_array_equal(first.mean, second.mean)


def test_without_its_three_changes_it_is_power() -> None:
    settings = ShapedPower.Settings(sigma=6, weights="return", decay=1.0, warm_up=0, mirrored=False)
    plain = climb(Power(SIZE, Power.Settings(), rng(3)), 40)
    np.testing.assert_allclose(
        climb(ShapedPower(SIZE, settings, rng(3)), 40).mean, plain.mean, rtol=1e-9, atol=1e-12
    )
