# SPDX-License-Identifier: Apache-2.0
"""Stamps keep every nanosecond, and one that is not set is refused."""

from __future__ import annotations

import time
import uuid

import pytest
from sensor_msgs.msg import JointState

from wam_power_ros.ros.stamps import goal_id, sensor_stamp, sent_ns


def test_a_stamp_that_is_not_set_is_refused() -> None:
    message = JointState()
    message.header.stamp.nanosec = 1
    assert sensor_stamp(message) == 1
    message.header.stamp.nanosec = 0
    with pytest.raises(ValueError, match="stamp is 0 ns"):
        sensor_stamp(message)


def test_the_id_of_a_goal_says_when_it_was_sent_and_is_its_own() -> None:
    before = time.time_ns()
    goals = [bytes(goal_id().uuid).hex() for _ in range(100)]
    after = time.time_ns()
    sent = [sent_ns(goal) for goal in goals]
    assert sent == sorted(sent) and len(set(goals)) == len(goals)
    assert before - 100 <= sent[0] and sent[-1] <= after


def test_the_id_of_another_sender_or_of_a_clock_that_is_ahead_says_now() -> None:
    ahead = uuid.UUID(int=uuid.uuid1().int | 0x0FFF << 64)  # in the year 5236
    for goal in (uuid.uuid4(), ahead):
        before = time.time_ns()
        assert before <= sent_ns(goal.hex) <= time.time_ns()
