# SPDX-License-Identifier: Apache-2.0
"""Joints that stand still while their reference moves: held by friction, or frozen."""

import numpy as np
import pytest
from rigid_arm import HOME, MODEL, PERIOD_NS, begin, speed

from wam_power_ros.control.joint_control import StationaryJoints, TrackingLost
from wam_power_ros.control.modes import Mode

DT = PERIOD_NS * 1e-9
J6 = 5
FRICTION = MODEL.friction[J6]
HOLDABLE = 2.0 * FRICTION + 0.04 * MODEL.tau_max[J6]
INERTIA = MODEL.mass_matrix(HOME).diagonal()
BENT = np.array([-0.02, 0.1, -0.06, 0.24, -0.1, -0.1, 0.31])  # displacements to the start


def bounded(joints: StationaryJoints, torque: float, due: float = 0.1) -> float:
    """Bounded feedback torque at joint 6 when it stands still, `due` [rad] from its reference."""
    feedback = torque * np.eye(7)[J6]
    found = joints.joints(HOME, HOME + due * np.eye(7)[J6])
    return joints.bounded(found, feedback, INERTIA, DT)[J6]


def stationary() -> StationaryJoints:
    joints = StationaryJoints(MODEL)
    assert joints.joints(HOME, HOME) == []
    return joints


def test_a_joint_is_stationary_when_its_position_repeats_and_its_reference_has_moved() -> None:
    joints, far = stationary(), HOME + 0.01
    assert joints.joints(HOME, HOME + 4e-4) == []
    assert joints.joints(HOME, HOME - 6e-4) == joints.joints(HOME, far) == list(range(7))
    count = 1e-5 * np.eye(7)[2]
    assert joints.joints(HOME + count, far) == [0, 1, 3, 4, 5, 6]
    assert joints.joints(HOME + count, far - 0.01) == [2]
    joints.begin()
    assert joints.joints(HOME + count, far) == []


def test_feedback_below_friction_is_never_reduced() -> None:
    joints = stationary()
    assert {bounded(joints, -0.99 * FRICTION) for _ in range(500)} == {-0.99 * FRICTION}


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_joint_that_would_be_fast_if_free_is_braked_and_then_gets_no_feedback(
    sign: float,
) -> None:
    joints, torque = stationary(), sign * 1.5 * FRICTION
    torques = [bounded(joints, torque) for _ in range(100)]
    states = 0.2 * INERTIA[J6] / (0.5 * FRICTION) / DT  # until it would be fast if free
    assert sum(each == torque for each in torques) == pytest.approx(states, abs=1.0)
    states = 0.2 * INERTIA[J6] / (2.5 * FRICTION) / DT  # until it would be at rest again
    assert sum(each == -torque for each in torques) == pytest.approx(states, abs=1.0)
    assert set(torques[-50:]) == {0.0}
    joints.joints(HOME + 1e-4, HOME)  # it moves
    joints.joints(HOME, HOME)
    assert bounded(joints, torque) == torque


def test_a_joint_that_friction_cannot_hold_gets_the_full_feedback_and_must_move() -> None:
    for torque in (1.01 * HOLDABLE, -1.01 * HOLDABLE):
        joints = stationary()
        assert {bounded(joints, torque) for _ in range(10)} == {torque}
        with pytest.raises(TrackingLost, match="joint 6 does not move under a feedback torque of"):
            bounded(joints, torque)


def test_states_in_which_friction_can_hold_a_joint_restart_its_timeout() -> None:
    joints = stationary()
    for _ in range(5):
        for _ in range(100):
            bounded(joints, 0.99 * HOLDABLE)
        assert {bounded(joints, 1.01 * HOLDABLE) for _ in range(10)} == {1.01 * HOLDABLE}


@pytest.mark.requirement("S-91")
@pytest.mark.parametrize("frozen", [range(7), (3,), (5,)], ids=["all", "4", "6"])
def test_a_joint_that_freezes_in_a_slow_move_ends_it_before_the_arm_is_fast(
    frozen: tuple[int, ...],
) -> None:
    controller, plant = begin(HOME + BENT, friction=1.0, delay=2, sensing=True)
    controller.move_to_start()
    at, speeds = list(frozen), []
    for k in range(800):
        stamp, q, qd = plant.state()
        if k == 180:
            kept = q[at]
        if k >= 180:
            q[at], qd[at] = kept, 0.0
        plant.step(controller.step(stamp, q, qd))
        speeds.append(speed(plant))
    assert max(speeds) < 0.5
    assert controller.mode is Mode.FAULT
    assert speeds[-1] < 0.05


@pytest.mark.requirement("S-93")
def test_twice_the_friction_is_not_mistaken_for_a_frozen_joint() -> None:
    controller, plant = begin(HOME + 0.2 * BENT, friction=2.0, delay=4, sensing=True)
    controller.move_to_start()
    for _ in range(500):
        plant.step(controller.step(*plant.state()))
    assert controller.mode is Mode.HOLD, controller.latched
