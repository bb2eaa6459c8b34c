# SPDX-License-Identifier: Apache-2.0
"""A rollout in one process: repeatable, scored with the scene's ground truth, stopped by limits."""

import dataclasses

import numpy as np
import pytest

from hardware_sim.scenes import scene_type
from hardware_sim.settings import SceneSettings, WorldSettings
from hardware_sim.world import World
from wam_power_ros.experiments.environment import Environment
from wam_power_ros.experiments.studies.flip_sessions import teach
from wam_power_ros.experiments.studies.reaching_arm import taught_scenario
from wam_power_ros.learning.policy import Policy, with_id


@pytest.fixture(scope="module")
def toss() -> Policy:
    """The policy of a demonstrated toss."""
    return teach(Environment(World(seed=21)), 21, 1)[0]


def test_a_rollout_of_one_seed_and_id_repeats_bit_for_bit_whatever_was_before(toss: Policy) -> None:
    fresh, used = (Environment(World(seed=21)) for _ in range(2))
    used.run(with_id(toss, "another"))
    (one, one_truth), (other, other_truth) = (each.run(toss) for each in (fresh, used))
    assert one_truth == other_truth and one.fault is None
    for name in ("t", "position", "quat_xyzw"):
        np.testing.assert_array_equal(getattr(one.tool, name), getattr(other.tool, name))
        np.testing.assert_array_equal(getattr(one.body, name), getattr(other.body, name))
    assert one_truth["tossed"]


def test_a_policy_that_is_too_fast_is_infeasible_and_ends_in_that_fault(toss: Policy) -> None:
    wild = dataclasses.replace(toss, attractors=toss.attractors + np.array([0.0, 0.0, 3.0]))
    environment = Environment(World(seed=21))
    assert environment.infeasible(toss) is None
    foreseen, (rollout, _) = environment.infeasible(wild), environment.run(wild)
    assert foreseen is not None and rollout.fault is not None
    assert foreseen.kind.of_policy and rollout.fault.kind.of_policy


def test_a_scene_without_a_body_gives_no_path_of_one_and_its_obstacle_ends_a_rollout() -> None:
    policy = taught_scenario().policy
    free = Environment(World(WorldSettings(), 21, scene_type("reach")))
    whole, _ = free.run(policy)
    assert whole.body is None
    x, y, z = whole.tool.position[len(whole.tool.t) // 3].tolist()
    settings = WorldSettings(scene=SceneSettings(obstacle=(x, y, z, 0.05)))
    stopped, truth = Environment(World(settings, 21, scene_type("reach"))).run(policy)
    assert stopped.fault is None
    assert abs(truth["clearance"]) < 0.002  # stopped where the encoders see the tool enter it
    assert stopped.tool.t[-1] < whole.tool.t[-1]
