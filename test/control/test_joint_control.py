# SPDX-License-Identifier: Apache-2.0
"""Joint-space control: PD feedback about a reference; bounded feedback for joints that stand."""

import numpy as np
import pytest
from rigid_arm import HOME, LIMITS, MODEL, NAMES, PERIOD_NS, begin, speed
from rigid_arm import MODEL as ARM

from wam_power_ros.control.joint_control import (
    JointControl,
    StationaryJoints,
    TrackingError,
    TrackingLost,
)
from wam_power_ros.control.modes import Mode

STILL = np.zeros(7)
MS = 1_000_000
AWAY = np.array([0.1, -0.05, 0.02, 0.0, -0.1, 0.2, 0.1])


def holding(at: np.ndarray = HOME) -> JointControl:
    """Joint control that has come to rest in a posture."""
    control = JointControl(ARM, LIMITS)
    for stamp in (0, 200 * MS):
        control.torque(stamp, at, STILL)
    assert control.holding
    return control


def test_a_displaced_arm_gets_the_same_pd_feedback_whatever_its_inertia() -> None:
    for q, qd in ((HOME, STILL), (HOME - AWAY, STILL), (HOME, AWAY[::-1]), (HOME + AWAY, AWAY)):
        wanted = 25.0**2 * (HOME - q) - 2.0 * 0.7 * 25.0 * qd
        expected = ARM.inverse_dynamics(q, qd, wanted)
        np.testing.assert_allclose(holding().torque(202 * MS, q, qd), expected, atol=1e-9)


def test_a_moving_reference_is_fed_forward_with_most_of_the_friction() -> None:
    control, goal = holding(), HOME + 3.0 * AWAY
    control.move(goal, 0.3)
    control.torque(0, HOME, STILL)
    assert not control.holding
    reference = control._references.reference
    for ms in (200, 400, 600):
        q, qd, qdd = reference.at(ms * 1e-3)
        # 80 % of the friction of the joints, in the direction in which the reference moves
        friction = 0.8 * (ARM.friction * np.tanh(qd / 0.02) + ARM.damping * qd)
        expected = ARM.inverse_dynamics(q, qd, qdd) + friction
        np.testing.assert_allclose(control.torque(ms * MS, q, qd), expected, atol=1e-9)
        stuck = ARM.inverse_dynamics(q, STILL, qdd + 2.0 * 0.7 * 25.0 * qd) + friction
        np.testing.assert_allclose(control.torque(ms * MS, q, STILL), stuck, atol=1e-9)
    end = round((reference.duration + 1.0) * 1e9)
    np.testing.assert_allclose(control.torque(end, goal, STILL), ARM.gravity(goal), atol=1e-9)
    assert control.holding


@pytest.mark.requirement("S-25")
@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize(("joint", "sign"), [(0, 1.0), (3, -1.0), (6, 1.0)])
def test_a_joint_0_3_rad_off_its_reference_is_a_fault_at_rest_and_in_motion(
    joint: int, sign: float, moves: bool
) -> None:
    control, way, stamp = holding(), sign * np.eye(7)[joint], 202 * MS
    if moves:
        control.move(HOME + AWAY, 0.3)
        control.torque(stamp, HOME, STILL)
    control.torque(stamp + 1, HOME + 0.299 * way, STILL)
    with pytest.raises(TrackingLost, match=r"0\.301 rad from its reference"):
        control.torque(stamp + 2, HOME + 0.301 * way, STILL)


def test_an_arm_may_lag_behind_while_it_brakes() -> None:
    control = JointControl(ARM, LIMITS)
    control.torque(0, HOME, 2.0 * np.eye(7)[3])
    behind = HOME - 0.25 * np.eye(7)[3]  # the braking distance is another 0.15 rad
    control.torque(100 * MS, behind, STILL)
    with pytest.raises(TrackingLost):
        control.torque(151 * MS, behind, STILL)


def test_a_reference_continues_from_the_last_one_and_after_a_release_from_the_measured_state() -> (
    None
):
    carried = HOME + AWAY
    for released, begins in ((False, HOME), (True, carried)):
        control = holding()
        if released:
            control.release()
        control.begin()
        control.torque(300 * MS, carried, STILL)
        assert np.array_equal(control._references.reference.at(0.0)[0], begins)


def test_the_error_of_joints_and_tool_is_reported() -> None:
    error = TrackingError(ARM)
    assert error.tool() == (0.0, 0.0) and not error.rms.any()
    for k in range(100):
        off = 0.01 * np.eye(7)[0] * (1.0 if k < 50 else 0.0)
        error.add(HOME + off, HOME)
    assert error.largest[0] == pytest.approx(0.01)
    assert error.rms[0] == pytest.approx(0.01 / np.sqrt(2.0))
    assert not error.rms[1:].any() and not error.largest[1:].any()
    reach = np.linalg.norm(ARM.tool_pose(HOME)[0][:2])  # from joint 1's axis
    rms, largest = error.tool()
    assert largest == pytest.approx(0.01 * reach, rel=0.01)
    assert rms == pytest.approx(0.01 * reach / np.sqrt(2.0), rel=0.05)
    assert error.text(NAMES).startswith("rms error 0.0071 rad in the worst joint, wam_j1\n")


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
