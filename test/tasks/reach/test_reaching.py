# SPDX-License-Identifier: Apache-2.0
"""Reaching past an obstacle (Sec. III-A, Eq. 4)."""

import numpy as np
import pytest

from wam_power_ros.experiments.studies import reaching_arm
from wam_power_ros.experiments.studies.reaching import TUNING, plain_path
from wam_power_ros.experiments.studies.reaching_runs import (
    NOISE,
    POWER,
    Run,
    generator,
    learn_many,
    study,
)
from wam_power_ros.experiments.studies.synthetic_reach import synthetic
from wam_power_ros.learning.learner import Learner
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.power import Power
from wam_power_ros.learning.random_search import RandomSearch
from wam_power_ros.learning.screened_power import ScreenedPower
from wam_power_ros.tasks.reach.obstacle_model import FreePath

SCENARIO = synthetic()
FULL = Parametrization(SCENARIO.policy, "full", NOISE["full"])


def drawn(count: int, seed: int = 0) -> list[Policy]:
    rng = np.random.default_rng(seed)
    return [FULL.policy(3.0 * rng.standard_normal(24), f"p{k}")[0] for k in range(count)]


def arrays(policies: list[Policy]) -> tuple[np.ndarray, np.ndarray]:
    return (
        np.stack([policy.stiffness for policy in policies]),
        np.stack([policy.attractors for policy in policies]),
    )


def paths(policies: list[Policy]) -> tuple[np.ndarray, np.ndarray]:
    return SCENARIO.stopped(SCENARIO.free(*arrays(policies)))


def run(learner: Learner, rollouts: int) -> Run:
    return learn_many([learner], FULL, SCENARIO, rollouts)[0]


def test_the_demonstrations_are_those_of_the_scenario() -> None:
    assert SCENARIO.demonstrations.shape == (4, 200, 3)
    np.testing.assert_allclose(SCENARIO.demonstrated[0], SCENARIO.start, atol=1e-12)
    np.testing.assert_allclose(SCENARIO.demonstrated[-1], SCENARIO.goal, atol=1e-12)
    assert np.linalg.norm(SCENARIO.goal - SCENARIO.start) == pytest.approx(0.5)
    rise = SCENARIO.demonstrated[:, 2].max() - SCENARIO.start[2]
    assert rise == pytest.approx(0.06, abs=1e-4)
    assert SCENARIO.policy.basis.count == 2


def test_the_demonstrated_policy_meets_the_obstacle_and_stays_there() -> None:
    path, collided = paths([SCENARIO.policy])
    assert collided[0]
    at = np.flatnonzero((path[0] == path[0, -1]).all(axis=1))[0]
    assert 0 < at < 150
    np.testing.assert_array_equal(path[0, at:], np.tile(path[0, at], (200 - at, 1)))
    assert np.linalg.norm(path[0, -1] - SCENARIO.obstacle) == pytest.approx(0.09, abs=0.01)


def test_without_the_obstacle_the_demonstrated_policy_follows_the_demonstration() -> None:
    path = plain_path(SCENARIO.policy, SCENARIO)
    # Two primitives, started at rest, lag behind half a metre of minimum jerk by a decimetre.
    assert np.linalg.norm(path - SCENARIO.demonstrated, axis=1).max() < 0.12
    assert np.linalg.norm(path[-1] - SCENARIO.goal) < 0.03


def test_no_sample_of_a_path_is_inside_the_obstacle() -> None:
    path, _ = paths(drawn(50))
    distance = np.linalg.norm(path - SCENARIO.obstacle, axis=-1)
    assert distance.min() >= SCENARIO.radius


def test_a_path_that_jumps_over_the_obstacle_between_two_samples_collides() -> None:
    side = np.where(np.arange(200) < 100, -0.2, 0.2)
    path = SCENARIO.obstacle + np.outer(side, [1.0, 0.0, 0.0])
    stopped, collided = SCENARIO.stopped(path[None])
    assert collided[0]
    np.testing.assert_array_equal(stopped[0], np.tile(path[0], (200, 1)))


def test_a_path_that_passes_the_obstacle_is_unchanged() -> None:
    path = SCENARIO.demonstrated + np.array([0.1, 0.0, 0.0])
    stopped, collided = SCENARIO.stopped(path[None])
    assert not collided[0]
    np.testing.assert_array_equal(stopped[0], path)


def test_returns_are_in_the_unit_interval() -> None:
    returns, _ = SCENARIO.evaluate(*arrays(drawn(100)))
    assert (returns >= 0.0).all() and (returns <= 1.0).all()


def test_a_return_is_that_of_the_policy_alone_and_of_equation_1_as_written() -> None:
    policies = drawn(8)
    returns, collided = SCENARIO.evaluate(*arrays(policies))
    alone = [SCENARIO.evaluate(*arrays([policy]))[0][0] for policy in policies]
    np.testing.assert_allclose(returns, alone, rtol=1e-9)
    plain = np.stack([plain_path(policy, SCENARIO) for policy in policies])
    path, plain_collided = SCENARIO.stopped(plain)
    np.testing.assert_allclose(path, paths(policies)[0], atol=1e-9)
    np.testing.assert_array_equal(collided, plain_collided)


@pytest.mark.parametrize("change", [{"radius": -0.1}, {"duration": 0.0}, {"count": 0}])
def test_a_scenario_out_of_range_is_refused(change: dict) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        synthetic(**change)


def test_the_same_seed_learns_the_same_whatever_the_number_of_workers() -> None:
    once = study("full", range(12), 10, SCENARIO, workers=1)
    again = study("full", range(12), 10, SCENARIO, workers=2)
    for first, second in zip(once, again, strict=True):
        np.testing.assert_array_equal(first.returns, second.returns)
        np.testing.assert_array_equal(first.mean, second.mean)
    assert once[0].final != once[1].final


@pytest.mark.parametrize("variant", ["full", "diagonal"])
def test_power_gets_far_beyond_the_demonstration(variant: str) -> None:
    start = SCENARIO.evaluate(*arrays([SCENARIO.policy]))[0][0]
    final = [run.final for run in study(variant, range(10), 60, SCENARIO)]
    assert np.mean(final) > start + 0.15


def test_a_run_tells_its_best_rollout_and_its_final_mean() -> None:
    learner = Power(FULL.size, POWER, generator(5))
    told = run(learner, 30)
    assert learner.count == 30 and told.returns.shape == told.means.shape == (30,)
    assert told.best == told.returns.max()
    policy, _ = FULL.policy(learner.mean, "mean")
    assert told.final == pytest.approx(SCENARIO.evaluate(*arrays([policy]))[0][0], rel=1e-12)


def test_the_final_policy_of_random_search_is_its_best_rollout() -> None:
    told = run(RandomSearch(FULL.size, RandomSearch.Settings(), generator(5)), 20)
    assert told.final == pytest.approx(told.best, rel=1e-9)


def test_a_model_predicts_a_free_path_exactly_and_a_stopped_one_better_each_time() -> None:
    model = FreePath(FULL, SCENARIO)
    z = np.random.default_rng(3).standard_normal((300, FULL.size)) * 6.0
    stiffness, attractors, _ = FULL.arrays(z)
    returns, collided = SCENARIO.evaluate(stiffness, attractors)
    assert 20 < collided.sum() < 280
    np.testing.assert_allclose(model.predict(z[~collided]), returns[~collided], rtol=1e-9)
    before = np.abs(model.predict(z) - returns)[200:].mean()
    for one, ret in zip(z[:200], returns[:200], strict=True):
        model.learn(one, float(ret))
    assert np.abs(model.predict(z) - returns)[200:].mean() < 0.7 * before


def test_screening_needs_clearly_fewer_rollouts_than_power() -> None:
    settings = ScreenedPower.Settings()
    screened, power = (
        learn_many(
            [
                ScreenedPower(FULL.size, settings, generator(seed), FreePath(FULL, SCENARIO))
                if screens
                else Power(FULL.size, POWER, generator(seed))
                for seed in TUNING[:4]
            ],
            FULL,
            SCENARIO,
            25,
        )
        for screens in (True, False)
    )
    gain = np.median([run.final for run in screened]) - np.median([run.final for run in power])
    assert gain > 0.1


def test_the_shipped_demonstrations_make_a_scenario_of_the_arm() -> None:
    scenario = reaching_arm.taught_scenario()
    assert scenario.demonstrations.shape == (4, 200, 3)
    way = scenario.goal - scenario.start
    assert np.linalg.norm(way) == pytest.approx(0.5, abs=0.05)
    stiffness, attractors = arrays([scenario.policy])
    assert scenario.evaluate(stiffness, attractors)[1][0]
    free = scenario.free(stiffness, attractors)[0]
    assert np.linalg.norm(free[-1] - scenario.goal) < 0.04


def test_a_learnt_reach_is_executed_near_its_plan() -> None:
    told = reaching_arm.executed_run("full", TUNING[0], 10)
    assert told["fault"] == ""
    assert told["rms"] < 0.06
    assert len(told["planned"]) == len(told["executed"])


def test_practice_on_the_arm_is_told_what_the_arm_did_and_repeats_itself() -> None:
    told = reaching_arm.practised_run("full", TUNING[0], 3)
    assert told == reaching_arm.practised_run("full", TUNING[0], 3)
    assert told["fault"] == "" and 0.0 < told["return"] < 1.0
    assert len(told["returns"]) == 3
