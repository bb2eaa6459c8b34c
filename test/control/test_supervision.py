# SPDX-License-Identifier: Apache-2.0
"""Supervision of the arm: plausibility, limits, and the estimate of the arm's state."""

from itertools import pairwise

import numpy as np
import pytest
from rigid_arm import HOME, LIMITS, MODEL, PERIOD_NS

from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import Mode
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.control.supervision import AGREEMENT, REST_NS, TRUST_STATES, Supervision
from wam_power_ros.faults import FaultKind

STILL = np.zeros(7)
GRAVITY = MODEL.gravity(HOME)


def supervision(tau: np.ndarray = GRAVITY) -> Supervision:
    return Supervision(MODEL, LIMITS, ControllerSettings(), lambda q: tau)


def state(tick: int, q: np.ndarray = HOME, qd: np.ndarray = STILL) -> JointState:
    return JointState(10**12 + tick * PERIOD_NS, q, qd, 0.002, 0.002)


def fault_kind(watch: Supervision, mode: Mode, ticks: int = 60) -> FaultKind | None:
    for tick in range(1, ticks):
        if fault := watch.plausibility_fault(mode, state(tick - 1), state(tick)):
            return fault.kind
    return None


def test_an_arm_that_does_not_move_under_a_large_torque_is_not_plausible() -> None:
    strong = GRAVITY + 0.2 * MODEL.tau_max
    for mode in (Mode.HOLD, Mode.MOVE_TO_START, Mode.REPLAY, Mode.ROLLOUT, Mode.FAULT):
        assert fault_kind(supervision(strong), mode) is FaultKind.EXTERNAL_TORQUE, mode
        assert fault_kind(supervision(), mode) is None, mode


def test_a_person_may_push_with_any_force_while_teaching_and_before_activation() -> None:
    strong = GRAVITY + 0.2 * MODEL.tau_max
    assert fault_kind(supervision(strong), Mode.GRAVITY_COMPENSATION) is None
    assert fault_kind(supervision(strong), Mode.INACTIVE) is None


def test_a_restart_of_the_checks_forgets_earlier_contradictions() -> None:
    strong = GRAVITY + 0.2 * MODEL.tau_max
    most = next(n for n in range(60) if fault_kind(supervision(strong), Mode.HOLD, n + 1))
    watch = supervision(strong)
    assert fault_kind(watch, Mode.HOLD, most) is None
    watch.begin()
    assert fault_kind(watch, Mode.HOLD, most) is None


def test_the_count_of_exceeded_limits_restarts_when_the_mode_changes() -> None:
    watch, fast = supervision(), np.full(7, 100.0)
    moving = state(0, qd=fast)
    motion = MODEL.motion(HOME, fast)
    seen = [watch.limit_fault(Mode.ROLLOUT, moving, motion) for _ in range(2)]
    watch.mode_changed()
    seen += [watch.limit_fault(Mode.REPLAY, moving, motion) for _ in range(2)]
    assert seen == [None] * 4
    fault = watch.limit_fault(Mode.REPLAY, moving, motion)
    assert fault is not None and fault.kind is FaultKind.JOINT_SPEED


def test_an_arm_in_a_fault_counts_as_rested_only_after_the_rest_time() -> None:
    watch, motion = supervision(), MODEL.motion(HOME, STILL)
    watch.faulted()
    ticks = REST_NS // PERIOD_NS
    for tick in range(ticks):
        watch.estimate(state(tick), motion, new=tick == 0)
        assert not watch.rested(state(tick).stamp_ns)
    watch.estimate(state(ticks), motion, new=False)
    assert watch.rested(state(ticks).stamp_ns)
    moved = MODEL.motion(HOME, np.full(7, 0.2))
    watch.estimate(state(ticks + 1), moved, new=False)
    assert not watch.rested(state(ticks + 1).stamp_ns)


def test_the_arm_is_estimated_from_the_state_of_the_fault_and_follows_those_after_it() -> None:
    strong, motion = GRAVITY + 0.2 * MODEL.tau_max, MODEL.motion(HOME, STILL)
    watch = supervision(strong)
    watch.faulted()
    first = watch.estimate(state(0), motion, new=True)
    np.testing.assert_array_equal(first.q, HOME)
    np.testing.assert_array_equal(first.qd, STILL)
    second = watch.estimate(state(1), motion, new=False)
    assert not np.array_equal(second.qd, STILL)


def test_without_states_the_model_predicts_the_arm_until_the_estimate_ends() -> None:
    watch, qd = supervision(), np.zeros(7)
    qd[1] = 0.5
    last = state(0, qd=qd)
    first = watch.predict(last, 0.002)
    second = watch.predict(last, 0.002)
    assert HOME[1] < first.q[1] < second.q[1]
    watch.end_estimate()
    np.testing.assert_array_equal(watch.predict(last, 0.002).q, first.q)


def test_the_prediction_begins_at_the_last_state_and_its_speed() -> None:
    watch, qd = supervision(), np.zeros(7)
    qd[0] = 0.5
    states = [state(tick, HOME + tick * 0.002 * qd, qd) for tick in range(100)]
    for before, after in pairwise(states):
        watch.plausibility_fault(Mode.GRAVITY_COMPENSATION, before, after)
    silent = watch.predict(states[-1], 0.002)
    np.testing.assert_allclose(silent.q, states[-1].q + 0.002 * qd, atol=5e-4)
    np.testing.assert_allclose(silent.qd, qd, atol=0.05)


def estimated(watch: Supervision, states: list[JointState]) -> list[JointState]:
    motion = MODEL.motion(HOME, STILL)
    return [watch.estimate(each, motion, new=False) for each in states]


@pytest.mark.requirement("S-121")
def test_states_are_trusted_until_one_was_called_false() -> None:
    watch = supervision()
    assert watch.trusted
    assert fault_kind(watch, Mode.FAULT) is None
    assert watch.trusted
    moving = [state(k, HOME + 0.01 * (k % 2)) for k in range(20)]  # at rest, by its velocity
    for before, after in pairwise(moving):
        watch.plausibility_fault(Mode.FAULT, before, after)
    assert not watch.trusted


@pytest.mark.requirement("S-121")
def test_a_torque_that_nothing_explains_may_be_true_and_its_states_stay_in_use() -> None:
    watch = supervision(GRAVITY + 0.2 * MODEL.tau_max)
    assert fault_kind(watch, Mode.HOLD) is FaultKind.EXTERNAL_TORQUE
    assert watch.trusted


@pytest.mark.requirement("S-121")
def test_a_velocity_that_no_motor_can_reach_in_one_state_makes_such_a_torque_a_false_state() -> (
    None
):
    watch, fast = supervision(), np.zeros(7)
    fast[1] = 0.5
    states = [state(0), *(state(k, HOME + 0.002 * (k - 1) * fast, fast) for k in range(1, 40))]
    for before, after in pairwise(states):
        if fault := watch.plausibility_fault(Mode.HOLD, before, after):
            break
    assert fault is not None and fault.kind is FaultKind.EXTERNAL_TORQUE
    assert not watch.trusted


@pytest.mark.requirement("S-121")
def test_states_count_again_once_they_have_agreed_with_the_model_for_a_while() -> None:
    watch = supervision()
    watch._doubt()
    estimated(watch, [state(k) for k in range(TRUST_STATES)])
    assert not watch.trusted
    estimated(watch, [state(TRUST_STATES)])
    assert watch.trusted


@pytest.mark.requirement("S-121")
def test_states_of_a_joint_that_moves_while_the_model_rests_never_count_again() -> None:
    speed = np.zeros(7)
    speed[1] = 1.01 * AGREEMENT / (TRUST_STATES * 0.002)
    watch = supervision()
    watch._doubt()
    for before, after in pairwise(
        estimated(watch, [state(k, HOME + 0.002 * k * speed) for k in range(400)])
    ):
        assert not watch.trusted
        assert np.abs(after.q - before.q).max() < 1e-6
    watch._doubt()
    estimated(watch, [state(400 + k, HOME + 0.0018 * k * speed) for k in range(400)])
    assert watch.trusted


@pytest.mark.requirement("S-121")
def test_after_a_jump_states_count_again_only_after_a_reset() -> None:
    watch = supervision()
    watch.jumped(None)
    estimated(watch, [state(k) for k in range(10 * TRUST_STATES)])
    assert not watch.trusted
    watch.begin()
    assert watch.trusted


@pytest.mark.requirement("S-121")
def test_after_a_jump_the_arm_is_braked_from_the_last_state_before_it() -> None:
    """What the joint was going to do is known; what it reports from then on never counts."""
    speed, jumps = np.array([0.3, 1.2, 0.0, 0.8, 0.0, 0.0, 0.0]), 0.5 * np.eye(7)[3]
    watch, before = supervision(), state(1, HOME, speed)
    watch.plausibility_fault(Mode.GRAVITY_COMPENSATION, state(0, HOME - 0.002 * speed), before)
    watch.jumped(before)
    first = watch.estimate(state(2, HOME + jumps, -speed), MODEL.motion(HOME, STILL), new=True)
    np.testing.assert_allclose(first.q, HOME + 0.002 * speed, atol=5e-4)
    np.testing.assert_allclose(first.qd, speed, atol=0.1)
    later = estimated(watch, [state(k, HOME + jumps, -speed) for k in range(3, 5)])
    watch.jumped(later[-1].moved(HOME + jumps, -speed))  # back and forth: that state was false
    (after,) = estimated(watch, [state(5, HOME, -speed)])
    np.testing.assert_allclose(after.q, later[-1].q, atol=0.01)


@pytest.mark.requirement("S-121")
def test_a_jump_before_the_last_reset_is_no_state_to_begin_with() -> None:
    watch = supervision()
    watch.jumped(state(1, HOME + 0.3, STILL))  # of an arm that nothing commanded then
    watch.begin()
    first = watch.estimate(state(2), MODEL.motion(HOME, STILL), new=True)
    np.testing.assert_allclose(first.q, HOME, atol=1e-3)


@pytest.mark.requirement("S-121")
@pytest.mark.parametrize("lasting", [False, True])
def test_a_speed_that_grows_after_a_false_state_is_braked_and_a_constant_one_is_a_drift(
    lasting: bool,
) -> None:
    for growth, braked in ((0.0, False), (0.8, True)):  # [rad/s^2] of joint 2
        watch, t = supervision(), 0.002 * np.arange(250)
        watch.jumped(None) if lasting else watch._doubt()
        way = 0.3 * t + 0.5 * growth * t**2
        states = [state(k, HOME + each * np.eye(7)[1]) for k, each in enumerate(way)]
        speed = estimated(watch, states)[-1].qd[1]
        assert not watch.trusted
        assert speed == pytest.approx(0.3 + 0.5 * growth if braked else 0.0, abs=0.05)
