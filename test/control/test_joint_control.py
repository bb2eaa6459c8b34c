# SPDX-License-Identifier: Apache-2.0
"""Joint-space control: PD feedback about a reference, by inverse dynamics."""

import numpy as np
import pytest
from rigid_arm import HOME, LIMITS, NAMES
from rigid_arm import MODEL as ARM

from wam_power_ros.control.joint_control import JointControl, TrackingError, TrackingLost
from wam_power_ros.control.joint_references import interpolated

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


def test_only_the_states_of_a_replay_count_for_its_error() -> None:
    t = np.linspace(0.0, 0.1, 11)
    replay = interpolated(t, HOME + 0.1 * t[:, None] * np.ones(7), 0.002)
    control = holding()
    assert control.replay_error is None
    control.move(HOME + AWAY, 0.3)
    assert control.replay_error is None
    control.move(replay.q[0], 0.3, replay)
    first = control.replay_error
    for tick in range(200):  # a move of 0.1 s, the replay of 0.1 s, and hold
        control.torque(tick * 2 * MS, HOME + 0.01 - 1e-6 * (tick % 2), STILL)
    assert control.holding and control.replay_error is first
    assert first.count == 50 and first.largest.max() == pytest.approx(0.01)
    control.move(replay.q[0], 0.3, replay)
    assert control.replay_error is not first and control.replay_error.count == 0


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
