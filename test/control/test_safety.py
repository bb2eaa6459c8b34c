# SPDX-License-Identifier: Apache-2.0
"""Limits and fallbacks as pure functions."""

import math
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rigid_arm import HOME as Q
from rigid_arm import LIMITS
from rigid_arm import MODEL as ARM

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Motion, Speeds
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import Mode
from wam_power_ros.control.safety import Limits
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.control.urdf_checks import Approach
from wam_power_ros.faults import Fault, FaultKind

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


@pytest.mark.requirement("S-26")
@given(qd=st.lists(st.floats(-0.05, 0.05), min_size=7, max_size=7).map(np.array))
def test_the_fallback_torque_never_adds_energy(qd: np.ndarray) -> None:
    tau = Controller(ARM).step(1, Q, qd)
    assert qd @ (tau - ARM.gravity(Q)) <= 1e-12  # rounding error


def exceeded(q: np.ndarray, qd: np.ndarray, **settings: object) -> Fault | None:
    limits = safety.limits_of(ARM, **({"workspace_min": (-1.5, -1.5, -1.5)} | settings))
    motion = ARM.motion(q, qd)
    return safety.motion_fault(
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
    assert exceeded(Q, slow, guarded_speed=0.5).text.startswith("elbow at")
    elbow_only = np.array([0, 0, 0, 3.0, 0, 0, 0])
    assert exceeded(Q, elbow_only, guarded_speed=0.5).text.startswith("forearm at")
    assert "z =" in exceeded(Q, still, workspace_max=(1.5, 1.5, 0.3)).text
    fault = exceeded(Q, 9.0 * LIMITS.qd_max)
    assert fault.kind is FaultKind.JOINT_SPEED and fault.kind.of_policy
    assert exceeded(Q, math.nan * np.eye(7)[2]) is not None


@pytest.mark.requirement("S-23")
def test_a_point_behind_the_plane_is_named_with_its_depth() -> None:
    tilted = safety.limits_of(ARM, plane=(0.6, 0.0, 0.8, 0.5))
    before, behind = [0.5, 9.0, 0.3], [0.3, 0.0, 0.3]  # 0.54 and 0.42
    assert safety.plane_fault({"elbow": before, "tool": before}, tilted) is None
    fault = safety.plane_fault({"elbow": behind, "tool": before}, tilted)
    assert fault.text.startswith("elbow is 0.080 m behind")
    assert fault.kind is FaultKind.PLANE and fault.kind.of_policy
    assert safety.plane_fault({"tool": [math.nan] * 3}, tilted) is not None
    for normal in (np.eye(3)[1], -np.eye(3)[2]):
        wall = safety.limits_of(ARM, plane=(*normal, 0.2))
        assert safety.plane_fault({"tool": (0.2 * normal).tolist()}, wall) is None
        assert "is 0.100 m behind" in safety.plane_fault({"tool": 0.1 * normal}, wall).text


@pytest.mark.requirement("S-24")
def test_a_joint_beyond_its_limit_may_move_back_but_not_further() -> None:
    for i in range(7):
        for end, out in ((LIMITS.q_max[i], 1.0), (LIMITS.q_min[i], -1.0)):
            q, qd = Q.copy(), np.zeros(7)
            q[i] = end + 0.05 * out
            assert exceeded(q, qd) is None  # parked at its stop
            qd[i] = -0.5 * out
            assert exceeded(q, qd) is None  # guided back
            qd[i] = 0.06 * out
            fault = exceeded(q, qd)
            assert fault.text.startswith(f"joint {i + 1} at {q[i]:.3f} rad, limits ")
            assert fault.kind is FaultKind.JOINT_POSITION
            q[i] = end - 0.01 * out
            assert exceeded(q, qd) is None  # within its limits it may move in both directions


def test_limits_that_nobody_chose_are_those_of_the_urdf() -> None:
    for name, of_arm in (("torque", "tau_max"), *((it, it) for it in ("q_min", "q_max", "qd_max"))):
        np.testing.assert_array_equal(getattr(LIMITS, name), getattr(ARM, of_arm))


POSITIVE = (
    *("torque", "torque_rate", "qd_max", "spring_torque"),
    *("guarded_speed", "tool_speed", "teaching_tool_speed"),
)


ARRAYS = [field.name for field in fields(Limits) if field.init and field.name != "approach"]


@pytest.mark.parametrize("name", ARRAYS)
def test_an_invalid_limit_is_refused_by_name(name: str) -> None:
    value = np.array(getattr(LIMITS, name), dtype=float)
    wrong = [np.full(value.shape, math.nan), np.full((*value.shape, 1), 1.0)]
    for place in np.ndindex(value.shape) if name in POSITIVE else []:
        for bad in (0.0, -1.0, math.inf):
            spoilt = value.copy()
            spoilt[place] = bad
            wrong.append(spoilt)
    for bad in wrong:
        with pytest.raises(ValueError, match=rf"limit {name}(\[| = | has shape )"):
            safety.limits_of(ARM, **{name: bad})
    if value.shape:
        kept = safety.limits_of(ARM, **{name: value})
        value[0] = 9.0
        assert getattr(kept, name)[0] != 9.0
        with pytest.raises(ValueError, match="read-only"):
            getattr(kept, name)[0] = 9.0


def test_limits_that_contradict_each_other_or_do_not_exist_are_refused() -> None:
    one = Approach(0.2, 4.0)
    assert safety.limits_of(ARM, approach=(one,) * 7).approach == (one,) * 7
    safety.limits_of(ARM, plane=(0.6, 0.0, 0.8, 7.0))
    plane = r"plane = .* must begin with a unit normal"
    low = np.array(LIMITS.workspace_min)
    low[2] = LIMITS.workspace_max[2]
    for wrong, text in (
        ({"approach": (one,) * 6}, "approach = "),
        ({"approach": (one,) * 6 + (Approach(-0.1, 4.0),)}, "approach = "),
        ({"approach": (Approach(0.2, 0.0),) * 7}, "approach = "),
        ({"q_min": LIMITS.q_max}, "q_min = .* must be below q_max"),
        ({"workspace_min": low}, "workspace_min = .* must be below workspace_max"),
        ({"plane": (0.6 - 2e-6, 0.0, 0.8 - 2e-6, 7.0)}, plane),
        ({"plane": (0.6 + 2e-6, 0.0, 0.8 + 2e-6, 7.0)}, plane),
        ({"speed": 1.0}, r"\['speed'\] do not exist; known: .*tool_speed"),
    ):
        with pytest.raises(ValueError, match=rf"limits? {text}"):
            safety.limits_of(ARM, **wrong)


def moving(**change: object) -> Motion:
    return ARM.motion(Q, np.zeros(7))._replace(**change)


def test_an_arm_is_at_rest_below_5_cm_a_second_and_0_2_radians_a_second() -> None:
    turning = np.eye(6)[4]
    for rest, unrest, text in (
        ({"tool_speed": 0.05}, {"tool_speed": 0.0501}, "moves at 0.050 m/s"),
        ({"guarded_speeds": [0.0, 0.05]}, {"guarded_speeds": [0.06, 0.0]}, "moves at 0.060 m/s"),
        ({"twist": 0.2 * turning}, {"twist": 0.21 * turning}, "turns at 0.210 rad/s"),
        ({"guarded_speeds": []}, {"twist": -0.21 * turning}, "turns at 0.210 rad/s"),
    ):
        assert safety.rest_violation(moving(**rest)) == ""
        assert text in safety.rest_violation(moving(**unrest))


def test_at_its_limits_an_arm_is_not_beyond_them() -> None:
    def found(motion: Motion | Speeds, workspace: bool = True) -> FaultKind | None:
        state = Q.tolist(), [0.0] * 7
        fault = safety.motion_fault(*state, motion, ARM.guarded, LIMITS, 4.0, workspace)
        return fault and fault.kind

    for over, tool, guarded in (
        (0.0, None, None),
        (0.001, FaultKind.TOOL_SPEED, FaultKind.GUARDED_SPEED),
    ):
        assert found(moving(tool_speed=4.0 + over)) == found(Speeds([0.0, 0.0], 4.0 + over)) == tool
        assert found(moving(guarded_speeds=[0.0, 2.0 + over])) == guarded
        assert found(Speeds([2.0 + over, 0.0], 0.0)) == guarded
    for sign, limit in ((-1.0, LIMITS.workspace_min), (1.0, LIMITS.workspace_max)):
        for axis in np.eye(3):
            assert found(moving(position=limit * axis)) is None
            outside = moving(position=(limit + 1e-6 * sign) * axis)
            assert found(outside) is FaultKind.WORKSPACE
            assert found(outside, workspace=False) is None


@pytest.mark.requirement("S-22")
def test_three_states_in_a_row_beyond_a_limit_of_the_mode_are_a_fault() -> None:
    check = safety.MotionCheck(safety.limits_of(ARM, teaching_tool_speed=0.5), ARM.guarded)
    state = JointState(0, Q, np.zeros(7), 0.002, 0.002)

    def faults(mode: Mode, *motions: Motion | Speeds) -> list[FaultKind | None]:
        check.begin()
        found = [check.fault(mode, state, motion) for motion in motions]
        return [fault and fault.kind for fault in found]

    fast, slow = moving(tool_speed=5.0), moving()
    for mode in Mode:
        passive = mode in (Mode.INACTIVE, Mode.FAULT)
        kind = None if passive else FaultKind.TOOL_SPEED
        assert faults(mode, fast, fast, fast, fast, slow) == [None, None, kind, kind, None]
        assert faults(mode, fast, fast, slow, fast, fast) == [None] * 5
        led = FaultKind.TOOL_SPEED if mode is Mode.GRAVITY_COMPENSATION else None
        assert faults(mode, *[moving(tool_speed=0.6)] * 3)[2] == led
        outside = moving(position=np.array([0.0, 0.0, 2.1]))
        outside_fault = FaultKind.WORKSPACE if mode in (Mode.ROLLOUT, Mode.REPLAY) else None
        assert faults(mode, *[outside] * 3)[2] == outside_fault
        elbow_low = moving(guarded_positions=[[0.0, 0.0, -0.6], [0.0, 0.0, 0.5]])
        alone = mode in (Mode.ROLLOUT, Mode.REPLAY, Mode.MOVE_TO_START)
        assert faults(mode, *[elbow_low] * 3)[2] == (FaultKind.PLANE if alone else None)
        tool_low = moving(position=np.array([0.0, 0.0, -0.6]))
        assert faults(mode, *[tool_low] * 3)[2] == (
            outside_fault or (FaultKind.PLANE if alone else None)
        )
        assert faults(mode, *[Speeds([0.0, 0.0], 0.0)] * 3)[2] is None


@pytest.mark.requirement("S-01")
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_torque_within_its_limit_is_reached_at_the_rate_limit(sign: float) -> None:
    wanted = sign * 0.9 * LIMITS.torque
    for dt in (1e-6, 0.001):
        sent = safety.limit_torque(wanted, np.zeros(7), dt, LIMITS)
        expected = sign * np.minimum(0.9 * LIMITS.torque, LIMITS.torque_rate * dt)
        assert sent == pytest.approx(expected)


@pytest.mark.requirement("S-24")
def test_a_spring_at_a_joint_limit_never_steps_in() -> None:
    springs, inside, beyond = safety.LimitSprings(LIMITS), Q, Q.copy()
    beyond[1] = LIMITS.q_max[1] + 0.05
    step = LIMITS.spring_torque[1] * 0.002 / safety.SPRING_RISE
    last, torques = 0.0, []
    for q in [inside] * 3 + [beyond] * 60 + [inside] * 60:
        given = springs.torque(q, 0.002)
        torques.append(0.0 if given is None else given[1])
        assert abs(torques[-1] - last) <= step * (1.0 + 1e-9)
        last = torques[-1]
    assert min(torques) == pytest.approx(-1.5 * LIMITS.spring_torque[1])
    assert springs.torque(inside, 0.002) is None


def test_a_spring_follows_a_joint_that_approaches_its_limit_at_two_radians_a_second() -> None:
    springs, q = safety.LimitSprings(LIMITS), Q.copy()
    for k in range(60):
        q[1] = LIMITS.q_max[1] - 0.11 + 2.0 * 0.002 * k
        given, wanted = springs.torque(q, 0.002), safety.limit_springs(q, LIMITS)
        assert (given is None) == (wanted is None)
        if wanted is not None:
            np.testing.assert_allclose(given, wanted, rtol=1e-9)
