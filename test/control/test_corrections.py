# SPDX-License-Identifier: Apache-2.0
"""What was measured on an arm corrects its model, and only that."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pinocchio as pin
import pytest
from rigid_arm import NAMES as JOINTS
from rigid_arm import URDF

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.corrections import Corrections
from wam_power_ros.control.fault_hold import BrakeWithoutModel
from wam_power_ros.control.safety import limits_of
from wam_power_ros.control.torque_output import TorqueOutput

Q = np.array([0.3, 0.5, -0.4, 1.7, 0.2, -0.6, 0.8])
QD = np.linspace(-1.0, 1.0, 7)


def arm(**values: object) -> Arm:
    return Arm(URDF, JOINTS, corrections=Corrections.from_values(7, **values))


PLAIN = Arm(URDF, JOINTS)


def test_without_a_correction_every_number_stays_bit_for_bit() -> None:
    same = arm()
    assert same.torque_scales is None
    for name in ("q_min", "q_max", "friction", "damping"):
        assert getattr(same, name).tobytes() == getattr(PLAIN, name).tobytes()
    assert same.bias(Q, QD).tobytes() == PLAIN.bias(Q, QD).tobytes()


def test_a_driver_that_adds_gravity_adds_that_of_the_urdf_and_the_rest_is_sent() -> None:
    corrected = arm(
        zeros=np.deg2rad([0.0, 2.0, -1.0, 3.0, 0.0, 1.0, 0.0]),
        payload=[0.2, 0.0, 0.0, 0.02],
        base_tilt=[0.02, -0.01],
        torque_scales=[0.9, 1.1, 1.0, 1.0, 0.95, 1.05, 1.0],
    )
    assert corrected.identity() == PLAIN.identity()
    assert np.array_equal(corrected.driver_gravity(Q), PLAIN.gravity(Q))
    assert not np.allclose(corrected.gravity(Q), PLAIN.gravity(Q), atol=0.1)
    output = TorqueOutput(corrected, limits_of(corrected), True, Counter())
    wanted = corrected.gravity(Q) + 0.5
    sent = output.send(wanted, Q, None)
    given = corrected.torque_scales * (sent + PLAIN.gravity(Q))
    assert np.allclose(given, wanted)
    assert np.allclose(output.motor_torque(Q), wanted)
    brake = BrakeWithoutModel(corrected, True)
    brake.observe(corrected, Q, np.full(7, 0.5))
    held = corrected.torque_scales * (brake.torque(None, 0.002) + PLAIN.gravity(Q))
    assert np.allclose(held, wanted)


def test_friction_may_be_larger_in_one_direction_and_at_low_speed() -> None:
    uneven = arm(friction_asymmetry=[0.1] * 7, low_speed_friction=[0.2] * 7)
    fast = np.full(7, 2.0)
    viscous = PLAIN.damping * fast
    forwards, backwards = uneven.friction_torque(fast), uneven.friction_torque(-fast)
    assert np.allclose(forwards - viscous, 1.1 * PLAIN.friction)
    assert np.allclose(backwards + viscous, -0.9 * PLAIN.friction)
    slow = np.full(7, 0.05)  # here a third of the rise is left
    risen = uneven.friction_torque(slow) - arm(friction_asymmetry=[0.1] * 7).friction_torque(slow)
    assert np.allclose(risen, 0.2 * np.exp(-1.0) * np.tanh(2.5) * PLAIN.friction)
    assert not uneven.friction_torque(np.zeros(7)).any()


def test_an_arm_with_zeros_moves_at_reported_angles_as_the_plain_one_at_true_ones() -> None:
    zeros = np.deg2rad([1.0, -2.0, 3.0, -1.5, 2.5, 2.0, -3.0])
    corrected = arm(zeros=zeros)
    for now, before in zip(corrected.tool_pose(Q + zeros), PLAIN.tool_pose(Q), strict=True):
        assert np.allclose(now, before, atol=1e-12)
    assert np.allclose(corrected.bias(Q + zeros, QD), PLAIN.bias(Q, QD), atol=1e-10)
    assert np.allclose(corrected.mass_matrix(Q + zeros), PLAIN.mass_matrix(Q), atol=1e-12)
    assert np.allclose(corrected.q_min - PLAIN.q_min, zeros)


def test_a_payload_is_a_point_mass_at_its_centre_for_gravity() -> None:
    mass, centre = 0.4, np.array([0.02, -0.01, 0.05])
    loaded = arm(payload=[mass, *(mass * centre)])
    _, rotation = PLAIN.tool_pose(Q)
    jacobian = PLAIN.jacobian(Q)
    lever = np.cross(rotation @ centre, [0.0, 0.0, mass * 9.81])
    weight = jacobian.T @ np.concatenate([[0.0, 0.0, mass * 9.81], lever])
    assert np.allclose(loaded.gravity(Q) - PLAIN.gravity(Q), weight, atol=1e-9)


def test_gravity_of_a_tilted_base_is_that_of_an_upright_one_seen_from_it() -> None:
    tilted = arm(base_tilt=[0.1, -0.2])
    model = PLAIN.model.copy()
    turn = pin.utils.rotate("x", 0.1) @ pin.utils.rotate("y", -0.2)
    model.gravity.linear = turn.T @ np.array([0.0, 0.0, -9.81])
    expected = pin.computeGeneralizedGravity(model, model.createData(), Q)
    assert np.allclose(tilted.gravity(Q), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"zeros": [0.1, 0.2]}, "zeros .* must be 7 finite numbers, or one for all"),
        ({"zeros": np.nan}, "zeros"),
        ({"torque_scales": 0.0}, "torque_scales .* must be positive"),
        ({"payload": [0.1, 0.0]}, "payload .* must be 4 finite numbers"),
        ({"stiffness": 1.0}, "stiffness"),
        ({"payload": [-5.0, 0.0, 0.0, 0.0]}, "payload -5 kg leaves"),
    ],
)
def test_other_numbers_are_refused_by_name(values: dict[str, object], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        arm(**values)
