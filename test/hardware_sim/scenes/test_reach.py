# SPDX-License-Identifier: Apache-2.0
"""Reaching: the script, and when the obstacle is touched."""

from __future__ import annotations

import numpy as np
import pytest

from hardware_sim.demonstrator import Demonstrator
from hardware_sim.scenes import HOME
from hardware_sim.scenes.reach import Reach, reach
from hardware_sim.settings import REACH_GOAL, WorldSettings
from hardware_sim.wam import JOINTS
from hardware_sim.world import World
from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm

POSITION, ROTATION = np.array([0.8, 0.0, 0.6]), rotations.exp(np.array([0.0, 0.4, 0.0]))


def world_with(*obstacle: float) -> World:
    """A world with an obstacle: x, y, z, radius [m]."""
    settings = WorldSettings(guarded_region=obstacle or (0.0,) * 4)
    return World(Reach, settings, seed=1)


def guide(world: World, rollout_id: str = "demonstration-0") -> tuple[np.ndarray, np.ndarray]:
    """Guide the gravity-compensated arm from `HOME` to `REACH_GOAL` without random differences.

    Returns:
        Measured joint positions (M, 7) [rad] and true positions of the tool (M, 3) [m].
    """
    arm = Arm(world.urdf, JOINTS)
    world.reset(rollout_id, HOME)
    world.release()
    world.attach(Demonstrator(reach(np.random.default_rng(0), spread=0.0), *world.tool_pose))
    joints, path = [], [world.tool_pose[0]]
    while world.pulled:
        sample = world.joint_state()
        joints.append(sample.q)
        world.step(arm.gravity(sample.q))
        assert not world.mocap_frames()  # nothing is tracked
        path.append(world.tool_pose[0])
    return np.array(joints), np.array(path)


def test_a_guided_arm_reaches_the_goal_with_a_level_pan_within_its_limits() -> None:
    world = world_with()
    arm = Arm(world.urdf, JOINTS)
    start, _ = arm.tool_pose(HOME)
    assert np.linalg.norm(REACH_GOAL - start) == pytest.approx(0.5, abs=0.01)
    q, path = guide(world)
    truth = world.truth()
    assert np.linalg.norm(path[-1] - REACH_GOAL) < 0.03
    assert truth["goal_distance"] == pytest.approx(np.linalg.norm(path - REACH_GOAL, axis=1).min())
    assert min(arm.tool_pose(posture)[1][2, 2] for posture in q) > np.cos(np.deg2rad(8.0))
    assert truth["peak_forearm_speed"] < 1.0  # [m/s] default limit of the safety board
    assert ((arm.q_min + 0.3 < q) & (q < arm.q_max - 0.3)).all()
    assert (truth["touched"], truth["clearance"]) == (False, None)  # there is no obstacle


def test_the_obstacle_is_touched_exactly_within_a_millimetre_of_the_tools_centre() -> None:
    _, path = guide(world_with())
    centre = path[len(path) // 2] + [0.05, 0.0, -0.02]
    nearest = float(np.linalg.norm(path - centre, axis=1).min())
    for margin in (-0.00101, -0.00099):  # a millimetre is tolerated
        world = world_with(*centre.tolist(), nearest + margin)
        _, again = guide(world)
        np.testing.assert_array_equal(again, path)  # no contact
        truth = world.truth()
        assert truth["touched"] is (margin > -0.001)
        assert truth["clearance"] == pytest.approx(-margin, abs=1e-12)


def test_a_scene_without_a_tracked_body_has_nothing_to_drop() -> None:
    with pytest.raises(ValueError, match="no tracked body"):
        world_with().drop()
