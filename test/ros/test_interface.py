# SPDX-License-Identifier: Apache-2.0
"""Messages and arrays: what is accepted comes back exactly, what is not is refused and named."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.ros import interface, joint_messages, pose_messages
from wam_power_ros.ros.stamps import nanoseconds, time_message

NAMES = [f"wam_j{i}" for i in range(1, 8)]
FINITE = st.floats(-1e6, 1e6)
SEVEN = st.lists(FINITE, min_size=7, max_size=7)
STAMPS = st.integers(1, 2**31 * 10**9 - 1)
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def joint_state(names: list[str], q: list[float], qd: list[float]) -> JointState:
    message = JointState(name=names, position=q, velocity=qd)
    message.header.stamp.sec = 1
    return message


@given(SEVEN, SEVEN, st.randoms(), st.integers(0, 3))
def test_joints_are_matched_by_name_in_any_order_beside_others(
    q: list[float], qd: list[float], shuffle: random.Random, others: int
) -> None:
    rows = [*zip(NAMES, q, qd, strict=True), *((f"finger{i}", 9.0, 9.0) for i in range(others))]
    shuffle.shuffle(rows)
    reading = joint_messages.JointStateReader(NAMES)(
        joint_state(*map(list, zip(*rows, strict=True)))
    )
    assert reading.q.tolist() == q
    assert reading.qd.tolist() == qd
    assert reading.stamp_ns == 10**9


def test_a_new_order_of_names_is_noticed() -> None:
    read = joint_messages.JointStateReader(NAMES)
    q = [float(i) for i in range(7)]
    for names in (NAMES, NAMES[::-1], NAMES):
        assert (
            read(joint_state(names, [q[NAMES.index(name)] for name in names], [])).q.tolist() == q
        )


def test_a_reading_does_not_change_when_its_message_is_used_again() -> None:
    write, read = joint_messages.JointStateWriter(NAMES), joint_messages.JointStateReader(NAMES)
    first = read(write(1, np.zeros(7), np.zeros(7), np.zeros(7)))
    read(write(2, np.ones(7), np.ones(7), np.ones(7)))
    assert first.q.tolist() == [0.0] * 7


@pytest.mark.parametrize("qd", [[], [math.nan] * 7, [0.0] * 6 + [math.nan]])
def test_velocity_that_is_left_out_or_nan_reads_as_none(qd: list[float]) -> None:
    assert joint_messages.JointStateReader(NAMES)(joint_state(NAMES, [0.0] * 7, qd)).qd is None


def test_a_message_of_another_device_is_nobodys_fault() -> None:
    assert joint_messages.JointStateReader(NAMES)(joint_state(["finger"], [0.0], [])) is None


@pytest.mark.parametrize(
    ("names", "q", "qd", "named"),
    [
        (NAMES[:6], [0.0] * 6, [], "wam_j7"),
        ([*NAMES, "wam_j1"], [0.0] * 8, [], "distinct"),
        (NAMES, [0.0] * 6, [], "position has 6"),
        (NAMES, [0.0] * 7, [0.0], "velocity has 1"),
        (NAMES, [0.0] * 6 + [math.nan], [], "position"),
        (NAMES, [math.inf] + [0.0] * 6, [], "position"),
        (NAMES, [math.inf, -math.inf] + [0.0] * 5, [], "position"),
        (NAMES, [0.0] * 7, [math.inf] + [0.0] * 6, "velocity"),
    ],
)
def test_a_bad_joint_state_is_refused_and_named(
    names: list[str], q: list[float], qd: list[float], named: str
) -> None:
    with pytest.raises(ValueError, match=named):
        joint_messages.JointStateReader(NAMES)(joint_state(names, q, qd))


def test_a_state_without_a_stamp_is_refused() -> None:
    message = joint_state(NAMES, [0.0] * 7, [])
    message.header.stamp = Time()
    with pytest.raises(ValueError, match="stamp"):
        joint_messages.JointStateReader(NAMES)(message)


def test_velocities_of_their_own_topic_may_be_nameless() -> None:
    read = joint_messages.JointStateReader(NAMES)
    assert read.velocity(JointState(velocity=[1.0] * 7)).tolist() == [1.0] * 7
    assert read.velocity(JointState(name=["finger"], velocity=[1.0])) is None
    with pytest.raises(ValueError, match="velocity has 6"):
        read.velocity(JointState(velocity=[1.0] * 6))


def test_a_joint_movement_comes_back_in_our_order() -> None:
    rng = np.random.default_rng(1)
    movement = joint_messages.JointMovement(np.array([0.0, 0.5, 1.25]), rng.normal(size=(3, 7)))
    order = [3, 6, 0, 2, 5, 1, 4]
    shuffled = joint_messages.movement_message(
        [NAMES[i] for i in order], movement._replace(q=movement.q[:, order])
    )
    back = joint_messages.movement(shuffled, NAMES)
    np.testing.assert_array_equal(back.t, movement.t)
    np.testing.assert_array_equal(back.q, movement.q)
    shuffled.points[1].positions[0] = math.nan
    with pytest.raises(ValueError, match="finite"):
        joint_messages.movement(shuffled, NAMES)
    with pytest.raises(ValueError, match="missing"):
        joint_messages.movement(shuffled, [*NAMES, "elbow"])


@given(STAMPS, SEVEN, st.sampled_from(["multiarray", "joint_state"]))
def test_a_torque_says_which_state_it_answers(
    stamp_ns: int, tau: list[float], command_type: str
) -> None:
    write = joint_messages.TorqueWriter(NAMES, command_type)
    reading = joint_messages.torque(write(stamp_ns, "rollout trial-0007", np.array(tau)), NAMES)
    assert reading.stamp_ns == stamp_ns
    assert reading.label == "rollout trial-0007"
    assert reading.tau.tolist() == tau


def test_a_torque_without_a_label_is_still_a_torque() -> None:
    reading = joint_messages.torque(Float64MultiArray(data=[1.0] * 7), NAMES)
    assert reading.stamp_ns is None
    assert reading.tau.tolist() == [1.0] * 7


@pytest.mark.parametrize("data", [[], [0.0] * 6, [0.0] * 8, [0.0] * 6 + [math.nan]])
def test_a_bad_torque_is_refused(data: list[float]) -> None:
    with pytest.raises(ValueError, match="torque"):
        joint_messages.torque(Float64MultiArray(data=data), NAMES)


@given(STAMPS, st.lists(FINITE, min_size=3, max_size=3))
def test_a_pose_comes_back_as_it_went(stamp_ns: int, position: list[float]) -> None:
    quat_xyzw = np.array([0.0, 0.6, 0.0, 0.8])
    reading = pose_messages.pose(pose_messages.pose_message(stamp_ns, "world", position, quat_xyzw))
    assert (reading.stamp_ns, reading.frame) == (stamp_ns, "world")
    assert reading.position.tolist() == position
    np.testing.assert_allclose(reading.quat_xyzw, quat_xyzw, atol=1e-15)


@pytest.mark.parametrize("number", [0.0, math.nan, math.inf, 2.0])
def test_a_pose_with_a_bad_quaternion_is_refused(number: float) -> None:
    message = PoseStamped()
    message.header.stamp.sec, message.pose.orientation.w = 1, number
    with pytest.raises(ValueError, match=r"quaternion|finite"):
        pose_messages.pose(message)


def test_a_state_comes_back_with_its_twist_in_the_base_frame() -> None:
    half = math.sqrt(0.5)  # a quarter turn about z: child x is base y
    state = pose_messages.StateReading(
        5,
        interface.BASE_FRAME,
        np.array([1.0, 2.0, 3.0]),
        np.array([0.0, 0.0, half, half]),
        np.array([0.0, 4.0, 0.0]),
        np.array([0.0, 0.0, 7.0]),
        1e-6,
    )
    message = pose_messages.odometry_message(state, "pancake")
    assert message.twist.twist.linear.x == pytest.approx(4.0)
    back = pose_messages.odometry(message)
    for was, is_now in zip(state[2:], back[2:], strict=True):
        np.testing.assert_allclose(is_now, was, atol=1e-12)


def test_markers_come_back_and_those_not_finite_are_left_out() -> None:
    points = np.array([[1.0, 2.0, 3.0], [math.nan, 0.0, 0.0], [4.0, 5.0, 6.0]])
    stamp_ns, frame, back = pose_messages.markers(pose_messages.markers_message(9, "world", points))
    assert (stamp_ns, frame) == (9, "world")
    np.testing.assert_array_equal(back, points[[0, 2]])


def test_a_cloud_of_another_layout_is_refused() -> None:
    message = pose_messages.markers_message(9, "world", np.zeros((2, 3)))
    message.data = message.data[:-1]
    with pytest.raises(ValueError, match="bytes"):
        pose_messages.markers(message)
    message.fields = message.fields[:2]
    with pytest.raises(ValueError, match="float32"):
        pose_messages.markers(message)


@given(st.integers(1, 200), st.integers(1, 10**18))
def test_a_rollout_path_keeps_its_id_start_and_poses(count: int, start_ns: int) -> None:
    t = np.arange(count) * 0.01
    there = EndEffectorPath(
        "trial-0007",
        t,
        np.random.default_rng(count).normal(size=(count, 3)),
        np.tile(LEVEL, (count, 1)),
    )
    message = pose_messages.path_message(there, start_ns, interface.BASE_FRAME)
    back_ns, back = pose_messages.path(message, EndEffectorPath)
    assert (back_ns, back.id) == (start_ns, there.id)
    np.testing.assert_allclose(back.t, t, atol=1e-9)
    np.testing.assert_array_equal(back.position, there.position)
    np.testing.assert_array_equal(back.quat_xyzw, there.quat_xyzw)


def test_an_empty_path_keeps_its_id() -> None:
    nothing = BodyPath("trial-0008", np.empty(0), np.empty((0, 3)), np.empty((0, 4)))
    message = pose_messages.path_message(nothing, 5, interface.BASE_FRAME)
    start_ns, back = pose_messages.path(message, BodyPath)
    assert (start_ns, back.id, len(back.t)) == (5, "trial-0008", 0)


def test_a_path_of_two_rollouts_is_refused() -> None:
    path = BodyPath("a", np.array([0.1, 0.2]), np.zeros((2, 3)), np.tile(LEVEL, (2, 1)))
    message = pose_messages.path_message(path, 5, interface.BASE_FRAME)
    message.poses[1].header.frame_id = "b"
    with pytest.raises(ValueError, match="ids"):
        pose_messages.path(message, BodyPath)
    message.poses.clear()
    with pytest.raises(ValueError, match="no pose"):
        pose_messages.path(message, BodyPath)


@given(STAMPS)
def test_stamps_are_exact(stamp_ns: int) -> None:
    assert nanoseconds(time_message(stamp_ns)) == stamp_ns


def test_topics_follow_the_name_of_the_tracked_body() -> None:
    assert interface.body_topic("pancake", "state") == "/pancake/state"
    assert interface.body_topic("ball", "reset") == "/ball/reset"
    assert interface.rollout_topic("ball") == "/rollout/ball"
    assert interface.body_topic("", "reset") == "/scene/reset"
    assert interface.body_topic("", "truth") == "/scene/truth"


@pytest.mark.parametrize(("body", "leaf"), [("ball", "poses"), ("", "pose"), ("", "state")])
def test_a_topic_that_no_body_has_is_refused_with_those_there_are(body: str, leaf: str) -> None:
    with pytest.raises(ValueError, match=rf"'{leaf}'.*truth"):
        interface.body_topic(body, leaf)


@pytest.mark.parametrize("body", ["a ball", "/ball", "2balls", "scene", "end_effector"])
def test_a_body_whose_name_makes_no_topic_of_its_own_is_refused(body: str) -> None:
    with pytest.raises(ValueError, match=r"name .* of a tracked body"):
        interface.body_topic(body, "pose")
    with pytest.raises(ValueError, match=r"name .* of a tracked body"):
        interface.rollout_topic(body)


def test_a_path_of_no_body_has_no_topic() -> None:
    with pytest.raises(ValueError, match=r"name '' of a tracked body"):
        interface.rollout_topic("")
