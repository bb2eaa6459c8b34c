# SPDX-License-Identifier: Apache-2.0
"""Pose messages give back the arrays they were made of; invalid ones are refused by name."""

from __future__ import annotations

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import KeyValue
from geometry_msgs.msg import PoseStamped
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware_sim import body_messages
from wam_power_interfaces.msg import GroundTruth
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.ros import pose_messages

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
STAMPS = st.integers(1, 2**31 * 10**9 - 1)

CLOUD = "sensor_msgs/msg/PointCloud2"


@given(STAMPS, st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3))
def test_a_pose_comes_back_unchanged(stamp_ns: int, position: list[float]) -> None:
    quat_xyzw = np.array([0.0, 0.6, 0.0, 0.8])
    reading = pose_messages.pose(pose_messages.pose_message(stamp_ns, "world", position, quat_xyzw))
    assert (reading.stamp_ns, reading.frame) == (stamp_ns, "world")
    assert reading.position.tolist() == position
    np.testing.assert_allclose(reading.quat_xyzw, quat_xyzw, atol=1e-15)


@pytest.mark.parametrize("number", [0.0, math.nan, 2.0])
def test_a_pose_with_a_bad_quaternion_is_refused(number: float) -> None:
    message = PoseStamped()
    message.header.stamp.sec, message.pose.orientation.w = 1, number
    with pytest.raises(ValueError, match=r"quaternion|finite"):
        pose_messages.pose(message)


def test_a_state_comes_back_with_its_twist_in_the_base_frame() -> None:
    half = math.sqrt(0.5)  # a quarter turn about z: child x is base y
    state = pose_messages.StateReading(
        5,
        "wam_base",
        np.array([1.0, 2.0, 3.0]),
        np.array([0.0, 0.0, half, half]),
        np.array([0.0, 4.0, 0.0]),
        np.array([0.0, 6.0, 7.0]),
        1e-6,
    )
    message = pose_messages.odometry_message(state, "pancake")
    twist = message.twist.twist
    assert [twist.linear.x, twist.linear.y] == pytest.approx([4.0, 0.0])
    assert [twist.angular.x, twist.angular.y, twist.angular.z] == pytest.approx([6.0, 0.0, 7.0])
    back = pose_messages.odometry(message)
    for was, is_now in zip(state[2:], back[2:], strict=True):
        np.testing.assert_allclose(is_now, was, atol=1e-12)


def test_markers_come_back_and_those_not_finite_are_left_out() -> None:
    points = np.array([[1.0, 2.0, 3.0], [math.nan, 0.0, 0.0], [4.0, 5.0, 6.0]])
    cloud = body_messages.message(CLOUD, 9, "world", "", points)
    stamp_ns, frame, back = pose_messages.markers(cloud)
    assert (stamp_ns, frame) == (9, "world")
    np.testing.assert_array_equal(back, points[[0, 2]])


def test_a_cloud_of_another_layout_is_refused() -> None:
    message = body_messages.message(CLOUD, 9, "world", "", np.zeros((2, 3)))
    message.data = message.data[:-1]
    with pytest.raises(ValueError, match="buffer"):
        pose_messages.markers(message)
    message.fields = message.fields[:2]
    with pytest.raises(ValueError, match="float32"):
        pose_messages.markers(message)


@settings(max_examples=20)
@given(st.integers(1, 200), st.integers(1, 10**18))
def test_a_rollout_path_keeps_its_start_and_poses_in_one_frame(count: int, start_ns: int) -> None:
    t = np.arange(count) * 0.01
    there = EndEffectorPath(
        "trial-0007",
        t,
        np.random.default_rng(count).normal(size=(count, 3)),
        np.tile(LEVEL, (count, 1)),
    )
    message = pose_messages.path_message(there, start_ns, "wam_base")
    back = pose_messages.path(message)
    assert back.start_ns == start_ns
    frames = {item.header.frame_id for item in (message, *message.poses)}
    assert frames == {"wam_base"}
    np.testing.assert_allclose(back.t, t, atol=1e-9)
    np.testing.assert_array_equal(back.position, there.position)
    np.testing.assert_array_equal(back.quat_xyzw, there.quat_xyzw)


def test_the_ground_truth_of_a_rollout_keeps_its_policy_end_and_values() -> None:
    values = {"caught": False, "apex": 0.4, "rest": None, "side": "left"}
    there = pose_messages.TruthReading("trial-0007", 10**18 + 7, values)
    assert pose_messages.ground_truth(pose_messages.ground_truth_message(there)) == there


@pytest.mark.parametrize("text", ["yes", "Infinity"])
def test_what_is_no_ground_truth_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="a value of the ground truth"):
        pose_messages.ground_truth(GroundTruth(values=[KeyValue(key="caught", value=text)]))
