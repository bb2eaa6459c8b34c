# SPDX-License-Identifier: Apache-2.0
"""Joint messages give back the arrays they were made of; invalid ones are refused by name."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from wam_power_ros.ros import joint_messages

NAMES = [f"wam_j{i}" for i in range(1, 8)]
SEVEN = st.lists(st.floats(-1e6, 1e6), min_size=7, max_size=7)
STAMPS = st.integers(1, 2**31 * 10**9 - 1)


def joint_state(names: list[str], q: list[float], qd: list[float]) -> JointState:
    message = JointState(name=names, position=q, velocity=qd)
    message.header.stamp.sec = 1
    return message


@pytest.mark.requirement("S-12")
@settings(max_examples=30)
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


@pytest.mark.requirement("S-14")
@pytest.mark.parametrize("qd", [[], [0.0] * 6 + [math.nan]])
def test_velocity_that_is_left_out_or_nan_reads_as_none(qd: list[float]) -> None:
    assert joint_messages.JointStateReader(NAMES)(joint_state(NAMES, [0.0] * 7, qd)).qd is None


@pytest.mark.parametrize(
    ("names", "q", "qd", "named"),
    [
        (NAMES[:6], [0.0] * 6, [], "wam_j7"),
        ([*NAMES, "wam_j1"], [0.0] * 8, [], "distinct"),
        (NAMES, [0.0] * 6, [], "position has 6"),
        (NAMES, [0.0] * 6 + [math.nan], [], "position"),
        (NAMES, [math.inf, -math.inf] + [0.0] * 5, [], "position"),
        (NAMES, [0.0] * 7, [math.inf] + [0.0] * 6, "velocity"),
    ],
)
def test_a_bad_joint_state_is_refused_and_named(
    names: list[str], q: list[float], qd: list[float], named: str
) -> None:
    with pytest.raises(ValueError, match=named):
        joint_messages.JointStateReader(NAMES)(joint_state(names, q, qd))


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


def test_a_torque_without_a_label_is_still_a_torque() -> None:
    reading = joint_messages.torque(Float64MultiArray(data=[1.0] * 7), NAMES)
    assert reading.stamp_ns is None and reading.tau.tolist() == [1.0] * 7


@pytest.mark.parametrize("data", [[0.0] * 6, [0.0] * 8, [0.0] * 6 + [math.nan]])
def test_a_bad_torque_is_refused(data: list[float]) -> None:
    with pytest.raises(ValueError, match="command"):
        joint_messages.torque(Float64MultiArray(data=data), NAMES)


def test_a_pose_is_sent_in_the_base_frame_alone_which_drivers_compare() -> None:
    pose = np.array([0.5, 0.1, 0.3, 0.0, 0.0, 0.6, 0.8])
    write = joint_messages.TorqueWriter(NAMES, "pose", 0.002, "base_link", to_stand_in=False)
    message = write(5, "hold", pose)
    assert message.header.frame_id == "base_link"
    reading = joint_messages.torque(message, NAMES, "base_link")
    assert reading.stamp_ns == 5 and reading.tau.tolist() == pose.tolist()
    with pytest.raises(ValueError, match="pose in frame 'base_link', not 'world'"):
        joint_messages.torque(message, NAMES, "world")
    for spoilt in (np.full(7, np.nan), np.zeros(7), np.append(pose[:3], 2.0 * pose[3:])):
        with pytest.raises(ValueError, match=r"finite|quaternion"):
            joint_messages.torque(write(5, "hold", spoilt), NAMES, "base_link")
