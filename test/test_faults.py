# SPDX-License-Identifier: Apache-2.0
"""Kinds of faults."""

from wam_power_ros.faults import FaultKind


def test_limits_of_motion_are_faults_of_the_policy_and_no_others_are() -> None:
    of_policy = {kind.value for kind in FaultKind if kind.of_policy}
    assert of_policy == {
        "joint_position",
        "joint_speed",
        "guarded_speed",
        "tool_speed",
        "workspace",
        "plane",
    }
