# SPDX-License-Identifier: Apache-2.0
"""Limits and fallbacks as pure functions."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.safety import Limits
from wam_power_ros.learning.rollout import Fault, FaultKind
from wam_power_ros.params.resources import share

NAMES = [f"wam_j{i}" for i in range(1, 8)]
ARM = Arm(share("urdf/wam7.urdf").read_text(), NAMES)
LIMITS = safety.limits_of(ARM)
Q = np.deg2rad([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0])
torques = st.lists(st.floats(-1e6, 1e6), min_size=7, max_size=7).map(np.array)


@pytest.mark.requirement("S-01")
@given(wanted=torques, previous=torques, dt=st.floats(0.0005, 0.004))
def test_a_torque_keeps_both_limits_and_is_untouched_within_them(
    wanted: np.ndarray, previous: np.ndarray, dt: float
) -> None:
    previous = np.clip(previous, -LIMITS.torque, LIMITS.torque)
    sent = safety.limit_torque(wanted, previous, dt, LIMITS)
    assert np.all(np.abs(sent) <= LIMITS.torque)
    assert np.all(np.abs(sent - previous) <= LIMITS.torque_rate * dt * (1 + 1e-12))
    assert np.array_equal(safety.limit_torque(sent, previous, dt, LIMITS), sent)
    within = (np.abs(wanted) <= LIMITS.torque) & (
        np.abs(wanted - previous) < LIMITS.torque_rate * dt * (1 - 1e-9)
    )
    assert np.array_equal(sent[within], wanted[within])


def test_a_repeated_wish_is_reached_bit_for_bit() -> None:
    wanted, sent = ARM.gravity(Q), np.zeros(7)
    for _ in range(25):
        sent = safety.limit_torque(wanted, sent, 0.002, LIMITS)
    assert np.array_equal(sent, wanted)


def test_soft_springs_push_inwards_and_only_near_a_limit() -> None:
    assert safety.limit_springs(Q, LIMITS) is None
    for i in range(7):
        for end, sign in ((LIMITS.q_max[i], -1.0), (LIMITS.q_min[i], 1.0)):
            q = Q.copy()
            q[i] = end
            springs = safety.limit_springs(q, LIMITS)
            assert springs[i] == pytest.approx(sign * LIMITS.spring_torque[i])
            assert np.count_nonzero(springs) == 1
            q[i] = end - 5.0 * sign  # far beyond: bounded
            assert abs(safety.limit_springs(q, LIMITS)[i]) <= 2.0 * LIMITS.spring_torque[i]


@pytest.mark.requirement("S-26")
@given(qd=st.lists(st.floats(-5.0, 5.0), min_size=7, max_size=7).map(np.array))
def test_the_live_fallback_never_feeds_energy_in(qd: np.ndarray) -> None:
    gravity = ARM.gravity(Q)
    tau = safety.live_fallback(gravity, ARM.mass_matrix(Q), qd, 20.0)
    assert qd @ (tau - gravity) <= 0.0


def test_teaching_damping_grows_with_the_square_of_the_speed() -> None:
    assert safety.teaching_damping(0.0) == 0.0
    assert safety.teaching_damping(2.5) == 1.0
    assert safety.teaching_damping(5.0) == 4.0


def exceeded(q: np.ndarray, qd: np.ndarray, **settings: object) -> Fault | None:
    limits = safety.limits_of(ARM, **({"workspace_min": (-1.5, -1.5, -1.5)} | settings))
    motion = ARM.motion(q, qd)
    return safety.exceeded(
        q.tolist(), qd.tolist(), motion, ARM.guarded, limits, limits.tool_speed, True
    )


@pytest.mark.requirement("S-21")
def test_each_motion_limit_is_named_when_exceeded() -> None:
    still = np.zeros(7)
    assert exceeded(Q, still) is None
    for i in range(7):
        qd = still.copy()
        qd[i] = -1.01 * LIMITS.qd_max[i]
        assert exceeded(Q, qd).text.startswith(f"joint {i + 1} at -")
    slow = 0.5 * LIMITS.qd_max * np.array([0, 1, 0, 0, 0, 0, 0])
    assert exceeded(Q, slow, tool_speed=0.5).text.startswith("tool at")
    assert exceeded(Q, slow, elbow_speed=0.5).text.startswith("elbow at")
    elbow_only = np.array([0, 0, 0, 3.0, 0, 0, 0])
    assert exceeded(Q, elbow_only, elbow_speed=0.5).text.startswith("forearm at")
    assert "z =" in exceeded(Q, still, workspace_max=(1.5, 1.5, 0.3)).text
    kinds = {
        FaultKind.JOINT_SPEED: exceeded(Q, 9.0 * LIMITS.qd_max),
        FaultKind.TOOL_SPEED: exceeded(Q, slow, tool_speed=0.5),
        FaultKind.GUARDED_SPEED: exceeded(Q, slow, elbow_speed=0.5),
        FaultKind.WORKSPACE: exceeded(Q, still, workspace_max=(1.5, 1.5, 0.3)),
    }
    assert all(fault.kind is kind and kind.of_policy for kind, fault in kinds.items())
    not_a_number = still.copy()
    not_a_number[2] = math.nan
    assert exceeded(Q, not_a_number) is not None


@pytest.mark.requirement("S-23")
def test_a_point_behind_the_plane_is_named_and_told_how_far() -> None:
    tilted = safety.limits_of(ARM, plane=(0.6, 0.0, 0.8, 0.5))
    before, behind = [0.5, 9.0, 0.3], [0.3, 0.0, 0.3]  # 0.54 and 0.42
    assert safety.behind_plane({"elbow": before, "tool": before}, tilted) is None
    assert safety.behind_plane({"elbow": behind, "tool": before}, tilted).text.startswith(
        "elbow is 0.080 m behind"
    )
    fault = safety.behind_plane({"wrist": behind}, tilted)
    assert fault.kind is FaultKind.PLANE and fault.kind.of_policy
    assert safety.behind_plane({"tool": [math.nan] * 3}, tilted) is not None


@pytest.mark.requirement("S-24")
def test_a_joint_beyond_its_limit_may_move_back_but_not_on() -> None:
    assert LIMITS.q_max[3] + 0.05 == pytest.approx(3.19, abs=0.01)
    for i in range(7):
        for end, out in ((LIMITS.q_max[i], 1.0), (LIMITS.q_min[i], -1.0)):
            q, qd = Q.copy(), np.zeros(7)
            q[i] = end + 0.05 * out
            assert exceeded(q, qd) is None  # parked at its stop
            qd[i] = -0.5 * out
            assert exceeded(q, qd) is None  # led back
            qd[i] = 0.06 * out
            fault = exceeded(q, qd)
            assert fault.text.startswith(f"joint {i + 1} at {q[i]:.3f} rad, limits ")
            assert fault.kind is FaultKind.JOINT_POSITION
            q[i] = end - 0.01 * out
            assert exceeded(q, qd) is None  # within its limits it may move either way


def test_limits_that_make_no_sense_are_refused_by_name() -> None:
    for name, value in (
        ("torque", -LIMITS.torque),
        ("torque_rate", np.zeros(7)),
        ("qd_max", np.ones(6)),
        ("q_min", LIMITS.q_max),
        ("elbow_speed", math.nan),
        ("workspace_max", (1.0, 1.0)),
        ("workspace_min", (2.0, 2.0, 2.0)),
        ("plane", (0.0, 0.0, 2.0, 0.1)),
        ("speed", 3.0),
    ):
        with pytest.raises(ValueError, match=name):
            safety.limits_of(ARM, **{name: value})


def test_limits_cannot_be_changed_afterwards() -> None:
    torque = ARM.tau_max.copy()
    limits = safety.limits_of(ARM, torque=torque)
    torque[0] = 1e6
    assert limits.torque[0] == ARM.tau_max[0]
    with pytest.raises(ValueError, match="read-only"):
        limits.torque[0] = 1e6
    assert isinstance(limits, Limits)
