# SPDX-License-Identifier: Apache-2.0
"""Supervision of the arm: plausibility, limits, and the estimate of the arm's state."""

from itertools import pairwise

import numpy as np
import pytest
from rigid_arm import HOME, LIMITS, MODEL, PERIOD_NS

from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import Mode
from wam_power_ros.control.reaction import ANSWER_TIME, REACTION_SPEED
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.control.supervision import AGREEMENT, BELIEF_STATES, Supervision
from wam_power_ros.control.unexplained_torque import UnexplainedTorque
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
    assert fault_kind(supervision(strong), Mode.GRAVITY_COMPENSATION) is None
    assert fault_kind(supervision(strong), Mode.INACTIVE) is None


def test_the_count_of_exceeded_limits_restarts_when_the_mode_changes() -> None:
    watch, moving = supervision(), state(0, qd=np.full(7, 100.0))
    motion = MODEL.motion(HOME, moving.qd)
    for mode in (Mode.ROLLOUT, Mode.REPLAY):
        watch.mode_changed()
        assert [watch.limit_fault(mode, moving, motion) for _ in range(2)] == [None] * 2
    assert watch.limit_fault(Mode.REPLAY, moving, motion).kind is FaultKind.JOINT_SPEED


def react(watch: Supervision, states: list[JointState]) -> list[np.ndarray]:
    """Torques in a fault for states that follow each other."""
    torques = []
    for before, after in pairwise(states):
        watch.plausibility_fault(Mode.FAULT, before, after)
        motion = MODEL.motion(after.q, after.qd)
        torques.append(watch.reaction_torque(after, motion))
    return torques


def faulted(kind: FaultKind, mode: Mode = Mode.HOLD, ticks: int = 120) -> Supervision:
    """Supervision of an arm that has rested, then had a fault of a kind."""
    watch = supervision()
    for before, after in pairwise([state(k - ticks) for k in range(ticks + 1)]):
        watch.plausibility_fault(mode, before, after)
    watch.faulted(mode, kind, UnexplainedTorque(MODEL))
    return watch


@pytest.mark.requirement("S-121")
def test_every_kind_of_fault_says_whether_its_states_are_believed() -> None:
    false = {FaultKind.JUMP, FaultKind.VELOCITY, FaultKind.DRIFT, FaultKind.STANDSTILL}
    assert {kind for kind in FaultKind if not faulted(kind, ticks=2).believed} == false


@pytest.mark.requirement("S-121")
def test_a_velocity_that_no_motor_can_reach_in_one_state_is_a_false_state() -> None:
    fast, mode = 0.5 * np.eye(7)[1], Mode.GRAVITY_COMPENSATION
    watch = supervision()
    assert watch.plausibility_fault(mode, state(0), state(1)) is None
    fault = watch.plausibility_fault(mode, state(1), state(2, HOME + 0.001 * fast, fast))
    assert fault.kind is FaultKind.VELOCITY


@pytest.mark.requirement("S-131")
def test_a_motion_that_no_torque_explains_is_not_believed_within_the_answer_time() -> None:
    """Joint 2 seems to accelerate at 15 rad/s^2, without a step: 25 N m that nobody sent."""
    watch, t = faulted(FaultKind.OVERLOAD), 0.002 * np.arange(45)
    states = [
        state(k, HOME + 7.5 * each**2 * np.eye(7)[1], 15.0 * each * np.eye(7)[1])
        for k, each in enumerate(t)
    ]
    for before, after in pairwise(states[:15]):
        watch.plausibility_fault(Mode.HOLD, before, after)
    watch.faulted(Mode.HOLD, FaultKind.EXTERNAL_TORQUE, UnexplainedTorque(MODEL))
    torques = react(watch, states[14:])
    assert not watch.believed
    change = np.abs(np.array(torques) - GRAVITY).max(axis=0)
    push = np.linalg.solve(MODEL.mass_matrix(HOME), np.maximum(change - MODEL.friction, 0.0))
    assert MODEL.motion(HOME, push * ANSWER_TIME).tool_speed < 1.5 * REACTION_SPEED
    assert np.abs(torques[-1] - GRAVITY).max() < MODEL.friction[1]


@pytest.mark.requirement("S-121")
def test_states_are_believed_again_once_they_have_agreed_with_the_model_for_a_while() -> None:
    watch = faulted(FaultKind.VELOCITY)
    react(watch, [state(k) for k in range(BELIEF_STATES)])
    assert not watch.believed
    react(watch, [state(BELIEF_STATES + k) for k in range(5)])
    assert watch.believed


@pytest.mark.requirement("S-121")
def test_states_of_a_joint_that_moves_while_the_model_rests_are_not_believed_again() -> None:
    speed = 1.05 * AGREEMENT / (BELIEF_STATES * 0.002) * np.eye(7)[1]
    watch = faulted(FaultKind.VELOCITY)
    torques = react(watch, [state(k, HOME + 0.002 * k * speed, speed) for k in range(400)])
    assert not watch.believed
    assert np.abs(torques[-1] - torques[0]).max() < 0.1


@pytest.mark.requirement("S-121")
@pytest.mark.parametrize("kind", [FaultKind.JUMP, FaultKind.DRIFT])
def test_after_a_jump_or_a_drift_no_rest_is_believed_before_the_reset(kind: FaultKind) -> None:
    watch = faulted(kind)
    react(watch, [state(k) for k in range(10 * BELIEF_STATES)])
    assert not watch.believed
    watch.begin()
    assert watch.believed


@pytest.mark.requirement("S-121")
def test_after_a_jump_the_arm_is_braked_from_the_states_before_it() -> None:
    speed, jumps = 0.8 * np.eye(7)[3], 0.5 * np.eye(7)[3]
    watch = supervision()
    states = [state(k, HOME + 0.002 * k * speed, speed) for k in range(200)]
    for before, after in pairwise(states):
        watch.plausibility_fault(Mode.GRAVITY_COMPENSATION, before, after)
    watch.faulted(Mode.GRAVITY_COMPENSATION, FaultKind.JUMP, UnexplainedTorque(MODEL))
    at = states[-1].q
    (tau,) = react(watch, [states[-1], state(200, at + jumps, -speed)])
    braking = tau - MODEL.gravity(at)
    assert braking[3] < -0.5 * 20.0 * MODEL.mass_matrix(at)[3, 3] * speed[3]
    assert np.abs(watch.reaction.posture - at).max() < 0.01
