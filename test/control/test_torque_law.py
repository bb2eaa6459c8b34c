# SPDX-License-Identifier: Apache-2.0
"""The torque law against Pinocchio's own dynamics."""

import numpy as np
import pinocchio as pin
import pytest

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.torque_law import TorqueLaw
from wam_power_ros.params.resources import share

NAMES = [f"wam_j{i}" for i in range(1, 8)]
Q = np.deg2rad([10.0, 20.0, -15.0, 100.0, 20.0, -40.0, 30.0])
QD = np.array([0.5, -1.0, 0.3, 2.0, -1.0, 3.0, 1.0])
WANTED = np.array([3.0, -2.0, 10.0, 5.0, 20.0, -7.0])
UNDAMPED = TorqueLaw(translation_damping=0.0, rotation_damping=0.0)


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm(share("urdf/wam7.urdf").read_text(), NAMES)


def torque(law: TorqueLaw, arm: Arm, q: np.ndarray = Q, qd: np.ndarray = QD) -> np.ndarray:
    return law.torque(arm.motion(q, qd), arm.dynamics(q, qd), qd, WANTED)


def tool_acceleration(arm: Arm, tau: np.ndarray, q: np.ndarray = Q) -> np.ndarray:
    return arm.jacobian(q) @ arm.forward_dynamics(q, QD, tau) + arm.motion(q, QD).drift


def test_a_wrench_by_the_jacobian_is_newton_euler_with_a_force_on_the_last_link(arm: Arm) -> None:
    law = TorqueLaw(kind="virtual_mass", mass=2.0, inertia=0.05)
    wrench = WANTED * np.repeat((2.0, 0.05), 3)
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, Q)
    at_tool = pin.SE3(np.eye(3), arm.tool_pose(Q)[0])
    on_link = data.oMi[arm.n].actInv(at_tool.act(pin.Force(wrench[:3], wrench[3:])))
    # Pinocchio's external forces stand in the frame of the joint and are subtracted.
    forces = [pin.Force.Zero() for _ in range(arm.n)] + [-on_link]
    expected = pin.rnea(arm.model, data, Q, QD, np.zeros(arm.n), forces)
    assert np.allclose(torque(law, arm), expected, atol=1e-10)


def test_the_tool_accelerates_as_wanted_in_operational_space(arm: Arm) -> None:
    assert np.allclose(tool_acceleration(arm, torque(UNDAMPED, arm)), WANTED, atol=1e-6)
    # The default damping takes at most a tenth of the translation, a quarter of the rotation.
    damped = tool_acceleration(arm, torque(TorqueLaw(), arm))
    assert np.allclose(damped[:3], WANTED[:3], rtol=0.1)
    assert np.allclose(damped[3:], WANTED[3:], rtol=0.25)


@pytest.mark.parametrize("kind", ["operational_space", "virtual_mass"])
def test_the_null_space_is_left_free(arm: Arm, kind: str) -> None:
    law = TorqueLaw(kind=kind)
    null = np.linalg.svd(arm.jacobian(Q))[2][-1]  # joint motion that does not move the tool
    assert abs(null @ (torque(law, arm) - arm.bias(Q, QD))) < 1e-9


def test_null_damping_slows_the_elbow_and_leaves_the_tool_alone(arm: Arm) -> None:
    law = TorqueLaw(translation_damping=0.0, rotation_damping=0.0, null_damping=4.0)
    tau = torque(law, arm)
    assert np.allclose(tool_acceleration(arm, tau), WANTED, atol=1e-6)
    null = np.linalg.svd(arm.jacobian(Q))[2][-1]
    qd = 0.3 * null
    change = torque(law, arm, qd=qd) - torque(UNDAMPED, arm, qd=qd)
    acceleration = np.linalg.solve(arm.mass_matrix(Q), change)
    assert np.allclose(acceleration, -4.0 * qd, atol=1e-6)


def test_damping_keeps_the_torque_small_where_the_arm_is_singular(arm: Arm) -> None:
    straight = np.zeros(7)
    for straight[5] in (0.0, 1e-9, 1e-6):
        damped = torque(TorqueLaw(), arm, straight) - arm.bias(straight, QD)
        assert np.abs(damped).max() < 100.0
    assert np.abs(torque(UNDAMPED, arm, straight)).max() > 1e4


def test_unfit_numbers_are_refused_by_name() -> None:
    for wrong in (
        {"kind": "magic"},
        {"mass": 0.0},
        {"inertia": -1.0},
        {"rotation_damping": np.nan},
        {"translation_damping": -0.1},
        {"null_damping": np.inf},
    ):
        with pytest.raises(ValueError, match=next(iter(wrong)) if "kind" not in wrong else "magic"):
            TorqueLaw(**wrong)
