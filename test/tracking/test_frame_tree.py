# SPDX-License-Identifier: Apache-2.0
"""Frames in each other, against homogeneous matrices."""

from __future__ import annotations

import numpy as np
import pytest

from wam_power_ros import rotations
from wam_power_ros.tracking.frame_tree import FrameTree, Pose

SECOND = 1_000_000_000
NOW = 1_795_000_000 * SECOND


def random_pose(rng: np.random.Generator) -> Pose:
    return rng.normal(size=3), rotations.normalised(rng.normal(size=4))


def matrix(pose: Pose) -> np.ndarray:
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = rotations.matrix(pose[1]), pose[0]
    return whole


@pytest.mark.parametrize("seed", range(3))
def test_any_two_frames_of_a_tree_see_each_other_as_matrices_say(seed: int) -> None:
    rng, tree, in_root = np.random.default_rng(seed), FrameTree(), {"root": np.eye(4)}
    for name in "abcdefgh":
        parent = str(rng.choice([*in_root]))
        pose = random_pose(rng)
        tree.add(name, parent, NOW, pose, fixed=True)
        in_root[name] = in_root[parent] @ matrix(pose)
    for frame, target in rng.choice([*in_root], size=(20, 2)):
        found = matrix(tree.pose(frame, target, NOW + 5))
        wanted = np.linalg.inv(in_root[target]) @ in_root[frame]
        np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_a_moving_frame_is_interpolated_between_its_neighbours_in_any_order_of_arrival() -> None:
    tree = FrameTree()
    for step in (0, 2, 1, 4, 3):
        t = 0.01 * step
        pose = np.array([t, 2 * t, 0.0]), rotations.quat_of_vector(np.array([0.0, 0.0, 3.0 * t]))
        tree.add("camera", "world", NOW + round(t * SECOND), pose, fixed=False)
    position, quat = tree.pose("camera", "world", NOW + 27_000_000)
    np.testing.assert_allclose(position, [0.027, 0.054, 0.0], atol=1e-12)
    np.testing.assert_allclose(rotations.rotation_vector(quat), [0.0, 0.0, 0.081], atol=1e-12)
    for late_ms, words in ((55, "15.0 ms older"), (-5, "5.0 ms newer")):
        with pytest.raises(ValueError, match=f"'camera' moves.*{words}"):
            tree.pose("camera", "world", NOW + late_ms * 1_000_000)


def test_a_frame_at_rest_is_known_later_too_and_old_poses_are_forgotten() -> None:
    tree, pose = FrameTree(), (np.ones(3), np.array([0.0, 0.0, 0.0, 1.0]))
    for step in range(100):
        tree.add("camera", "world", NOW + step * SECOND // 10, pose, fixed=False)
    np.testing.assert_allclose(tree.pose("camera", "world", NOW + 60 * SECOND)[0], 1.0)
    with pytest.raises(ValueError, match="newer than this"):
        tree.pose("camera", "world", NOW)
    tree.add("camera", "world", NOW - 100 * SECOND, pose, fixed=False)  # the clock was set back
    tree.add("camera", "world", NOW - 99 * SECOND, pose, fixed=False)
    tree.pose("camera", "world", NOW - 98 * SECOND)


def test_frames_that_are_not_connected_are_refused_with_the_known_ones() -> None:
    tree, pose = FrameTree(), (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    with pytest.raises(ValueError, match=r"'camera' is not connected to 'world'; /tf has \[\]"):
        tree.pose("camera", "world", NOW)
    tree.add("a", "b", NOW, pose, fixed=True)
    tree.add("b", "a", NOW, pose, fixed=True)  # a circle ends as well
    with pytest.raises(ValueError, match=r"/tf has \['a', 'b'\]"):
        tree.pose("a", "world", NOW)
