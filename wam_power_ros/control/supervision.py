# SPDX-License-Identifier: Apache-2.0
"""Supervision of the arm: plausibility of its states, motion limits, and estimate of its state.

The state is estimated while joint states are missing, and in a fault.
"""

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm, Motion, Speeds
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.estimate import Estimate
from wam_power_ros.control.modes import Mode
from wam_power_ros.control.plausibility import Bound, Plausibility
from wam_power_ros.control.state_checks import JointState, at_rate
from wam_power_ros.faults import Fault

INERTIAL_SHARE = 0.3  # of the accelerating torque, may be unexplained: sensors and motors lag
STANDING_SHARE = 0.05  # share of a torque limit: bound at a joint that stands still in a rollout
# Numbers of states are those at 500 Hz: at a higher rate they are more, see `at_rate`.
REST_NS = 200_000_000  # [ns] at rest before a fault may be reset
TRUST_STATES = 50  # consecutive states that agree until states are used again: 0.1 s
SPEED_STATES = 25  # states over which a reported speed is measured: 50 ms
FALL_SPEED = 0.15  # [rad/s] growth of a reported speed after which the arm is taken to fall
AGREEMENT = 0.005  # [rad] in that time, between the motion reported and that of the model

MotorTorque = Callable[[np.ndarray], np.ndarray]  # posture (n,) [rad] -> motor torque (n,) [N m]


class Supervision:
    """Checks every joint state, and estimates the arm's state when it is missing or not plausible.

    Nothing acts on a state that was called false: from then on the model alone says where the arm
    is, until for `TRUST_STATES` states in a row every check passes and the joints report the motion
    that the model predicts, which is rest. After a jump of a joint that is not enough: its position
    remains unknown. An arm whose model is wrong, too, may fall meanwhile. A zero that drifts does
    so at a constant speed; a speed that grows, in states that pass every check, is braked.

    Attributes:
        trusted: Whether joint states are used: none was called false, or they agree again.

    Args:
        arm: Model of the arm.
        limits: Limits of the arm.
        settings: Settings of the controller.
        motor_torque: Motor torque that results from the last command, as a function of posture.
    """

    def __init__(
        self,
        arm: Arm,
        limits: safety.Limits,
        settings: ControllerSettings,
        motor_torque: MotorTorque,
    ) -> None:
        self._motor_torque, self._period = motor_torque, settings.period
        self._trust_states = at_rate(TRUST_STATES, settings.period)
        self._speed_states = at_rate(SPEED_STATES, settings.period)
        self._motion = safety.MotionCheck(limits, arm.guarded, settings.period)
        self._plausibility = Plausibility(arm, settings.period)
        self._estimate: Estimate | None = None
        self._rest_since_ns: int | None = None  # stamp since which an arm in a fault is at rest
        self.trusted, self._lasting = True, False
        self._before_jump: JointState | None = None  # last state before the jump of this fault
        self._agreed = 0  # consecutive states that agree with the model
        self._agreed_from: np.ndarray | None = None  # reported minus predicted at their first [rad]
        self._plausible = 0  # consecutive states that passed every check since `doubt`
        self._reported: deque[np.ndarray] = deque(maxlen=self._speed_states + 1)  # positions [rad]
        self._slowest = np.full(arm.n, math.inf)  # least reported speeds since then [rad/s]
        self._falling = False  # one of them has grown since then
        bound = settings.contact_share * arm.tau_max
        contact = Bound(bound, bound, INERTIAL_SHARE)
        in_rollout = Bound(settings.unexplained_share * arm.tau_max, STANDING_SHARE * arm.tau_max)
        self._bounds: dict[Mode, Bound | None] = {
            Mode.GRAVITY_COMPENSATION: None,
            Mode.HOLD: contact,
            Mode.MOVE_TO_START: contact,
            Mode.ROLLOUT: in_rollout,
            Mode.REPLAY: contact,
            Mode.FAULT: in_rollout,
        }

    def begin(self) -> None:
        """Restart the plausibility checks: the next state has no predecessor."""
        self._plausibility.begin()
        self.trusted, self._lasting, self._before_jump = True, False, None

    def jumped(self, before: JointState | None) -> None:
        """Use no state any more, but the last one before the jump, if it was true."""
        if self.trusted:
            self._doubt()
            self._before_jump = before
        self._lasting = True

    def _doubt(self) -> None:
        """Use no state until states have agreed with the model for a while."""
        self.trusted, self._agreed, self._estimate = False, 0, None
        self._reported.clear()
        self._plausible, self._falling = 0, False
        self._slowest = np.full(self._slowest.shape, math.inf)

    def mode_changed(self) -> None:
        """Restart the count of states beyond a motion limit: other limits apply."""
        self._motion.begin()

    def faulted(self) -> None:
        """Restart the time at rest that a reset requires."""
        self._rest_since_ns = None

    def plausibility_fault(
        self, mode: Mode, before: JointState | None, state: JointState
    ) -> Fault | None:
        """Fault of a state that fails a plausibility check, or None.

        Args:
            mode: Current mode.
            before: Previous state, None when it is too long ago to compare with.
            state: Current state.
        """
        if mode is Mode.INACTIVE:
            return None
        tau = self._motor_torque(state.q)
        fault = self._plausibility.fault(before, state, tau, self._bounds[mode])
        if fault is not None:
            self._agreed = 0
            if self.trusted and self._plausibility.contradictory:
                self._doubt()
        return fault

    def limit_fault(self, mode: Mode, state: JointState, motion: Motion | Speeds) -> Fault | None:
        """Fault of a motion beyond the limits of the mode, or None."""
        return self._motion.fault(mode, state, motion)

    def end_estimate(self) -> None:
        """Use the measured states again."""
        self._estimate = None

    def predict(self, last: JointState, dt: float) -> JointState:
        """Predict the arm's state while joint states are missing.

        Args:
            last: Last state received.
            dt: Time since this state or since the last call [s].
        """
        arm = self._estimate = self._estimate or self._plausibility.estimate(last, suspect=0)
        arm.advance(self._motor_torque(arm.q), dt)
        return last.moved(arm.q, arm.qd)

    def estimate(self, state: JointState, motion: Motion | Speeds, new: bool) -> JointState:
        """Estimate the arm's state in a fault, when the measured one may be false.

        Args:
            state: Measured state.
            motion: Kinematics of the measured state.
            new: Whether the fault was found in this state.
        """
        plausible = self._plausibility.implausible_ns != state.stamp_ns
        if not isinstance(motion, Motion) or safety.rest_violation(motion) or not plausible:
            self._rest_since_ns = None
        elif self._rest_since_ns is None:
            self._rest_since_ns = state.stamp_ns
        arm = self._estimate = self._estimate or self._begun(state)
        if not new:
            self._watch_speed(state, plausible)
            used = self.trusted or self._falling
            arm.follow(state, self._motor_torque(arm.q), used)
        if not self.trusted:
            self._compare(state.q - arm.q)
        return state.moved(arm.q, arm.qd)

    def _begun(self, state: JointState) -> Estimate:
        """Estimate to begin with at a state; after a jump from the true state before it."""
        before, self._before_jump = self._before_jump, None
        if before is None:
            return self._plausibility.estimate(state)
        arm = self._plausibility.estimate_at(before)
        arm.advance(self._motor_torque(arm.q), state.span)
        return arm

    def _watch_speed(self, state: JointState, plausible: bool) -> None:
        """Notice that states which pass every check report a speed that grows."""
        self._plausible = self._plausible + 1 if plausible else 0
        reported = self._reported
        reported.append(state.q)
        if len(reported) <= self._speed_states:
            return
        speeds = np.abs(reported[-1] - reported[0]) / (self._speed_states * self._period)
        self._slowest = np.minimum(self._slowest, speeds)
        grown = float((speeds - self._slowest).max())
        if self._plausible > self._trust_states and grown > FALL_SPEED:
            self._falling = True

    def _compare(self, difference: np.ndarray) -> None:
        """Count a state whose position differs from the model's by (n,) [rad]."""
        begun = self._agreed_from
        if not self._agreed or begun is None or np.abs(difference - begun).max() > AGREEMENT:
            self._agreed, self._agreed_from = 0, difference
        self._agreed += 1
        self.trusted = self._agreed > self._trust_states and not self._lasting

    def rested(self, stamp_ns: int) -> bool:
        """Whether the arm has been at rest for `REST_NS`, in plausible states."""
        return self._rest_since_ns is not None and stamp_ns - self._rest_since_ns >= REST_NS
