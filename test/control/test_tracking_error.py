# SPDX-License-Identifier: Apache-2.0
"""Statistics of the tracking error of a replay."""

import numpy as np
import pytest

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.joint_control import TOOL_STRIDE, TrackingError
from wam_power_ros.params.resources import share

NAMES = [f"wam_j{number}" for number in range(1, 8)]
ARM = Arm(share("urdf/wam7.urdf").read_text(), NAMES)
Q = np.deg2rad([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0])


def test_the_error_of_joints_and_tool_is_reported() -> None:
    error = TrackingError(ARM)
    for k in range(100):
        off = 0.01 * np.eye(7)[0] * (1.0 if k < 50 else 0.0)
        error.add(Q + off, Q)
    assert error.count == 100
    assert error.largest[0] == pytest.approx(0.01)
    assert error.rms[0] == pytest.approx(0.01 / np.sqrt(2.0))
    assert not error.rms[1:].any() and not error.largest[1:].any()
    reach = np.linalg.norm(ARM.tool_pose(Q)[0][:2])  # from joint 1's axis
    rms, largest = error.tool()
    assert largest == pytest.approx(0.01 * reach, rel=0.01)
    assert rms == pytest.approx(0.01 * reach / np.sqrt(2.0), rel=0.05)
    lines = error.text(NAMES).splitlines()
    assert lines[0] == "rms error 0.0071 rad in the worst joint, wam_j1"
    assert len(lines) == 9


def test_before_any_state_all_errors_are_zero() -> None:
    error = TrackingError(ARM)
    assert error.tool() == (0.0, 0.0)
    assert not error.rms.any()


def test_the_tool_is_compared_every_few_states_and_every_joint_in_each() -> None:
    error = TrackingError(ARM)
    for k in range(10 * TOOL_STRIDE):
        error.add(Q + 0.001 * k, Q)
    assert error.count == 10 * TOOL_STRIDE
    assert error.largest[3] == pytest.approx(0.001 * (error.count - 1))
    last = TOOL_STRIDE * (error.count // TOOL_STRIDE - 1)  # compared
    apart = ARM.tool_pose(Q + 0.001 * last)[0] - ARM.tool_pose(Q)[0]
    assert error.tool()[1] == pytest.approx(np.linalg.norm(apart))
