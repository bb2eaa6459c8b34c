# SPDX-License-Identifier: Apache-2.0
"""The torque laws against Pinocchio's dynamics."""

import numpy as np
import pinocchio as pin
import pytest
from rigid_arm import NAMES, URDF

from wam_power_ros.control import torque_law
from wam_power_ros.control.arm import Arm

Q = np.deg2rad([10.0, 20.0, -15.0, 100.0, 20.0, -40.0, 30.0])
QD = np.array([0.5, -1.0, 0.3, 2.0, -1.0, 3.0, 1.0])
WANTED = np.array([3.0, -2.0, 10.0, 5.0, 20.0, -7.0])


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm(URDF, NAMES)


def torque(law: str, arm: Arm, q: np.ndarray = Q) -> np.ndarray:
    return getattr(torque_law, law)(arm.motion(q, QD), arm.dynamics(q, QD), WANTED)


def test_a_wrench_by_the_jacobian_is_newton_euler_with_a_force_on_the_last_link(arm: Arm) -> None:
    wrench = WANTED * np.repeat((1.0, 0.01), 3)
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, Q)
    at_tool = pin.SE3(np.eye(3), arm.tool_pose(Q)[0])
    on_link = data.oMi[arm.n].actInv(at_tool.act(pin.Force(wrench[:3], wrench[3:])))
    # Pinocchio expresses external forces in the frame of the joint, and subtracts them.
    forces = [pin.Force.Zero() for _ in range(arm.n)] + [-on_link]
    expected = pin.rnea(arm.model, data, Q, QD, np.zeros(arm.n), forces)
    assert np.allclose(torque("virtual_mass", arm), expected, atol=1e-10)


def test_the_tool_has_the_commanded_acceleration_in_operational_space(arm: Arm) -> None:
    tau, motion, dynamics = torque("operational_space", arm), arm.motion(Q, QD), arm.dynamics(Q, QD)
    jacobian = dynamics.jacobian
    reached = jacobian @ arm.resisted_dynamics(Q, QD, tau, np.zeros(7), 0.0) + motion.drift
    # The damping reduces the translation by at most a tenth, the rotation by a quarter.
    wrench = np.linalg.pinv(jacobian.T) @ (tau - dynamics.bias)
    assert np.allclose(reached + torque_law.DAMPING @ wrench, WANTED, atol=1e-6)
    assert np.allclose(reached[:3], WANTED[:3], rtol=0.1)
    assert np.allclose(reached[3:], WANTED[3:], rtol=0.25)


def test_damping_keeps_the_torque_small_where_the_arm_is_singular(
    arm: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    straight = 1e-6 * np.eye(7)[5]
    damped = torque("operational_space", arm, straight) - arm.dynamics(straight, QD).bias
    assert np.abs(damped).max() < 100.0
    monkeypatch.setattr(torque_law, "DAMPING", np.zeros((6, 6)))
    assert np.abs(torque("operational_space", arm, straight)).max() > 1e4
