# SPDX-License-Identifier: Apache-2.0
"""PoWER with a warm-up, rank weights and mirrored sampling."""

import numpy as np
from hill_task import SIZE, climb, hill, rng

from wam_power_ros.learning.power import Power
from wam_power_ros.learning.shaped_power import ShapedPower


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
