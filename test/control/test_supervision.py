# SPDX-License-Identifier: Apache-2.0
"""Supervision of the arm: plausibility, limits, and the estimate of the arm's state."""

from itertools import pairwise

import numpy as np
from rigid_arm import HOME, LIMITS, MODEL, PERIOD_NS

from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import Mode
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.control.supervision import REST_NS, Supervision
from wam_power_ros.learning.rollout import FaultKind

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
