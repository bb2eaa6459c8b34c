# SPDX-License-Identifier: Apache-2.0
"""Stamps keep every nanosecond, and one that is not set is refused."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import JointState

from wam_power_ros.ros.stamps import nanoseconds, sensor_stamp, time_message


@given(st.integers(1, 2**31 * 10**9 - 1))
def test_stamps_are_exact(stamp_ns: int) -> None:
    assert nanoseconds(time_message(stamp_ns)) == stamp_ns


def test_a_stamp_that_is_not_set_is_refused() -> None:
    message = JointState()
    message.header.stamp.nanosec = 1
    assert sensor_stamp(message) == 1
    message.header.stamp.nanosec = 0
    with pytest.raises(ValueError, match="stamp is 0 ns"):
        sensor_stamp(message)
