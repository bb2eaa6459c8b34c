# SPDX-License-Identifier: Apache-2.0
"""Speeds near position limits, as Franka's descriptions state them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.modes import Mode
from wam_power_ros.control.safety import MotionCheck, limits_of
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.faults import FaultKind

URDF = (ROOT / "urdf/fr3.urdf").read_text()
NAMES = [f"fr3_joint{number}" for number in range(1, 8)]
ARM = Arm(URDF, NAMES, "fr3_pan", guarded=())
LIMITS = replace(limits_of(ARM), tool_speed=9.0)
HOME = np.array([0.0, -0.8, 0.0, -2.3, 0.0, 1.6, 0.8])


def allowed(q: np.ndarray, joint: int, way: float) -> float:
    """Largest speed of a joint [rad/s] by the formula that Franka publishes."""
    room = ARM.q_max[joint] - q[joint] if way > 0.0 else q[joint] - ARM.q_min[joint]
    offset, deceleration = ARM.approach[joint]
    return float(np.sqrt(2.0 * deceleration * room) - offset)


@pytest.mark.parametrize(("joint", "way", "room"), [(3, 1.0, 0.3), (1, -1.0, 0.4)])
def test_a_joint_that_approaches_its_limit_too_fast_is_a_fault_and_one_that_leaves_is_none(
    joint: int, way: float, room: float
) -> None:
    q, qd = HOME.copy(), np.zeros(7)
    q[joint] = ARM.q_max[joint] - room if way > 0.0 else ARM.q_min[joint] + room
    most = allowed(q, joint, way)
    assert 0.0 < most < 0.9 * ARM.qd_max[joint]

    def fault(speed: float) -> str:
        qd[joint] = speed
        check, motion = MotionCheck(LIMITS, ARM.guarded), ARM.motion(q, qd)
        state = JointState(0, q, qd, 0.002, 0.002)
        found = [check.fault(Mode.HOLD, state, motion) for _ in range(5)][-1]
        return "" if found is None else f"{found.kind.value}: {found.text}"

    assert fault(way * most) == fault(-way * (most + 0.1)) == ""
    expected = f"{FaultKind.JOINT_SPEED.value}: joint {joint + 1} "
    assert fault(way * (most + 0.1)).startswith(expected)
