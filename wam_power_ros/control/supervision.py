# SPDX-License-Identifier: Apache-2.0
"""Supervision of the arm: are its states believed, does it move within its limits, does it rest."""

from collections import deque

import numpy as np

from wam_power_ros.control import safety
from wam_power_ros.control.arm import FRICTION_SPEED, Arm, Motion, Speeds
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import MOVING_MODES, Mode
from wam_power_ros.control.payload import PayloadCheck
from wam_power_ros.control.plausibility import Bound, Plausibility
from wam_power_ros.control.reaction import (
    BEFORE,
    BEFORE_GUIDED,
    BEFORE_STEP,
    FALL_SPEED,
    MotorTorque,
    Reaction,
)
from wam_power_ros.control.state_checks import JointState, at_rate
from wam_power_ros.control.unexplained_torque import UnexplainedTorque
from wam_power_ros.faults import Fault, FaultKind

INERTIAL_SHARE = 0.3  # of the accelerating torque, may be unexplained: sensors and motors lag
STANDING_SHARE = 0.05  # share of a torque limit: bound at a joint that stands still in a rollout
FAULT_SHARE = 0.15  # share of a torque limit: beyond it no motion in a fault is believed
USUAL_TIME = 1.0  # [s] in which an unexplained torque that stays becomes usual
SLIDING = 2.5 * FRICTION_SPEED  # [rad/s] from which the sign of a joint's friction is known
END_DISTANCE = 0.1  # [rad] from the end of a movement, to where what the joints needed there holds
REST_NS = 200_000_000  # [ns] at rest before a fault may be reset
DOUBTFUL_STATES = 12  # consecutive states that nothing explains until none is believed
BELIEF_STATES = 50  # consecutive states that agree until states are believed again: 0.1 s
FALL_STATES = 75  # consecutive states of an arm that falls until they are believed again: 0.15 s
FIRST_STATES = 500  # states after the activation in which gravity may turn out to be wrong: 1 s
GRAVITY_SHARE = 0.15  # of g(q), which a low-passed residual must have then
FALL_SHARE = 0.5  # of the change of momentum of an arm that falls, which may be unexplained
AGREEMENT = 0.005  # [rad] in that time, between the motion reported and that of the model


class Supervision:
    """Asks of every joint state whether it is believed, and reacts to a fault.

    States are not believed any more when a joint jumped, positions and velocities contradict each
    other, a hold's torque creeps although no joint reports a motion, or in a fault nothing explains
    the motion or the brake makes the reported arm faster. They are believed again when they agreed
    with the model for `BELIEF_STATES` in a row, at rest if nothing else was wrong with them, or
    report an arm that falls as the torques explain; after a jump never before the reset.

    Attributes:
        reaction: What brakes and holds the arm in a fault.
    """

    def __init__(
        self,
        arm: Arm,
        limits: safety.Limits,
        settings: ControllerSettings,
        motor_torque: MotorTorque,
    ) -> None:
        self._arm, self._motor_torque = arm, motor_torque
        self._unexplainable = 2.0 * arm.friction + FAULT_SHARE * arm.tau_max
        self._usual = np.zeros(arm.n)  # residual, low-passed: of a model that is wrong [N m]
        # Torques beyond g(q) under which each joint stood since it slid [N m]; and where [rad].
        self._least = self._most = self._moved_to = np.full(arm.n, np.nan)
        self._explains = False  # model, friction and torques explain the motion of the last state
        self._possible = False  # they do if up to 15 % of a torque limit may be unexplained
        self._unexplained = 0  # consecutive states of a motion that they do not explain
        self._guided = False  # a person guided the arm in the last state
        self._suspect = False  # something moved the arm at the fault that they do not explain
        self._doubtful = at_rate(DOUBTFUL_STATES, settings.period)
        self._payload = PayloadCheck(arm, settings.period)
        self._belief_states = at_rate(BELIEF_STATES, settings.period)
        self._fall_states = at_rate(FALL_STATES, settings.period)
        self._motion = safety.MotionCheck(limits, arm.guarded, settings.period)
        self._plausibility = Plausibility(arm, settings.period)
        self.reaction = Reaction(arm, motor_torque, settings.period)
        self._explainable = self.reaction.known
        self._rest_since_ns: int | None = None  # stamp since which an arm in a fault is at rest
        self.believed, self._lasting = True, False
        self._states, self._first_states = 0, at_rate(FIRST_STATES, settings.period)
        self._gravity_wrong = False  # the driver adds g(q) though it should not, or the reverse
        self._doubted = False  # states of this fault were not believed, so show no mass either
        # A reason not to believe them that no torque removes; they may be again only after a fall.
        self._contradicted = self._drifts = False
        self._agreed = 0  # consecutive states that agree with the model
        self._agreed_from: np.ndarray | None = None  # reported minus predicted at their first [rad]
        self._weight: np.ndarray | None = None  # unexplained torque that is a weight's [N m]
        self._rest_states = round(BEFORE / settings.period)
        self._usual_before = deque([self._usual], maxlen=self._rest_states)
        self._at_rest = np.zeros(arm.n)  # residual when it last reported rest [N m]
        # Speeds [rad/s] and residual [N m] at the first of these, and what it has changed [N m s].
        self._fall: tuple[np.ndarray, np.ndarray, np.ndarray]
        self._explained = 0  # consecutive states whose motion the torques explain
        bound = settings.contact_share * arm.tau_max
        contact = Bound(bound, bound, INERTIAL_SHARE)
        standing, fault = STANDING_SHARE * arm.tau_max, FAULT_SHARE * arm.tau_max
        self._bounds: dict[Mode, Bound] = {
            Mode.GRAVITY_COMPENSATION: Bound(np.full(arm.n, np.inf), np.full(arm.n, np.inf)),
            Mode.HOLD: contact,
            Mode.MOVE_TO_START: contact,
            Mode.ROLLOUT: Bound(settings.unexplained_share * arm.tau_max, standing),
            Mode.REPLAY: contact,
            Mode.FAULT: Bound(fault, fault),
        }

    def begin(self) -> None:
        """Restart the plausibility checks: the next state has no predecessor."""
        self._plausibility.begin()
        self.reaction.forget()
        self.reaction.end()
        self.believed, self._lasting = True, False
        self._states, self._gravity_wrong = 0, False
        self._least = self._most = self._moved_to = np.full(self._arm.n, np.nan)

    def mode_changed(self) -> None:
        """Restart the count of states beyond a motion limit: other limits apply."""
        self._motion.begin()

    def faulted(self, mode: Mode, kind: FaultKind, unexplained: UnexplainedTorque) -> None:
        """React to a fault of any kind, found in a mode."""
        self._rest_since_ns = None
        self.believed, self._contradicted, self._lasting = True, False, False
        self._drifts, self._doubted, self._unexplained = False, False, 0
        self._payload.begin()
        self._suspect = bool((np.abs(self._plausibility.residual) > self._explainable).any())
        guided = mode is Mode.GRAVITY_COMPENSATION
        if guided:
            self._usual = np.zeros(self._arm.n)
        sudden = BEFORE_STEP if kind.of_states else BEFORE_GUIDED
        alone = kind.of_states or mode in MOVING_MODES
        if held := mode is Mode.HOLD:
            self.reaction.carried = self._holding(kind, unexplained)
        self.reaction.begin(sudden if guided else BEFORE, alone, guided, held)
        if mode in MOVING_MODES:
            usual = self._usual_before[0]  # the last of it has what was found
            lag = (mode is Mode.ROLLOUT) & (np.abs(usual) <= self._arm.friction)
            self.reaction.carried = np.where(lag, 0.0, -usual)  # of sensors and motors, if fast
        elif not held:  # what held it there; elsewhere the share of friction in it is not known
            self.reaction.carried = unexplained.before(self.reaction.posture)
        past = list(self.reaction.past)[-self._rest_states :]
        self._at_rest = np.array(past[0].external) if past and not guided else 0.0 * self._usual
        if kind is FaultKind.DRIFT:
            self.reaction.assume_speeds(-unexplained.drift)
        if kind.of_states:
            self.doubt(kind)

    def _holding(self, kind: FaultKind, unexplained: UnexplainedTorque) -> np.ndarray:
        """Torque (n,) [N m] beyond g(q) that held the arm until a fault.

        Friction holds a joint as well under the least as under the most torque under which it
        stood since it moved; the one that held it last may be at the edge. So take half-way. At a
        joint that follows the drift of its zero it is what would rest it; a hold that still settles
        after a move looks alike, but leaves no more unexplained than friction explains.
        """
        past = self.reaction.past
        at = past[max(0, len(past) - self._belief_states)].q if past else self.reaction.posture
        held, half = unexplained.before(at), 0.5 * self._arm.friction
        if not unexplained.drift.any() and (found := self.reaction.followed()) is not None:
            joint, torque = found
            before = past[-min(self._rest_states, len(past))].external[joint]
            if kind is FaultKind.DRIFT or abs(before) > self._arm.friction[joint]:
                model_error = torque - self._arm.gravity(past[-1].q)
                return np.where(np.arange(self._arm.n) == joint, model_error, held)
        if kind is FaultKind.DRIFT or not np.abs(self._moved_to - at).max() < END_DISTANCE:
            return held
        amid = 0.5 * (np.fmin(self._least, held) + np.fmax(self._most, held))
        return np.minimum(np.maximum(amid, held - half), held + half)

    def doubt(self, kind: FaultKind) -> None:
        """Believe no state until they agree again; never again in this fault after a jump."""
        self.believed, self._agreed, self._doubted = False, 0, True
        self._explained = -self._fall_states  # the brake that ends is no fall
        self._contradicted |= kind.of_states
        self._lasting |= kind is FaultKind.JUMP
        self._drifts |= kind in (FaultKind.DRIFT, FaultKind.STANDSTILL)
        self.reaction.distrust()

    def plausibility_fault(
        self, mode: Mode, before: JointState | None, state: JointState
    ) -> Fault | None:
        """Fault of a state that fails a plausibility check, or None.

        Args:
            before: Previous state, None when it is too long ago to compare with.
        """
        if mode is Mode.INACTIVE:
            return None
        tau, checks = self._motor_torque(state.q), self._plausibility
        if before is None:
            self.reaction.forget()
            self._explained = -self._fall_states  # no speed is known that could have changed
        guided, self._guided = self._guided, mode is Mode.GRAVITY_COMPENSATION
        if guided and not self._guided and mode is not Mode.FAULT:
            checks.let_go()
        fault = checks.fault(before, state, tau, self._bounds[mode])
        self.reaction.record(state, tau, checks.residual)
        residual = np.array(checks.residual)
        self._states += 1
        self._gravity_wrong &= mode is Mode.FAULT
        if fault is not None and mode is Mode.HOLD and self._states < self._first_states:
            fault = self._gravity_fault(state.q, residual) or fault
        self._usual = self._usual + state.span / USUAL_TIME * (residual - self._usual)
        self._usual_before.append(self._usual)
        if mode in MOVING_MODES and mode is not Mode.ROLLOUT:
            slides = np.abs(state.qd) > SLIDING
            self._least = np.where(slides, -residual, np.fmin(self._least, -residual))
            self._most = np.where(slides, -residual, np.fmax(self._most, -residual))
            self._moved_to = state.q
        if mode is not Mode.FAULT:
            return fault
        braking = self.believed and not self._doubted and not self.reaction.rested
        frozen = self.believed and self.reaction.frozen
        moves = bool(np.abs(self.reaction.reported()).max() >= SLIDING)
        if frozen and not moves:
            self._payload.begin()  # a mass may be lost or put on later
        weighs = braking or (frozen and moves)
        self._weight = self._payload.torque(self.reaction.past) if weighs else None
        left = np.abs(residual - self._usual)
        self._explains = self._weight is not None or bool((left <= self._explainable).all())
        self._possible = self._weight is not None or bool((left <= self._unexplainable).all())
        if not self._possible:
            self._unexplained += 1
        elif before is not None:
            self._unexplained = 0
        if fault is not None and fault.kind.of_states:
            self.doubt(fault.kind)
        elif self._suspect and (
            self._unexplained >= self._doubtful
            or (braking and self._payload.refuted)
            or (self.believed and self.reaction.unanswered)
        ):
            self.doubt(FaultKind.EXTERNAL_TORQUE)
        return fault

    def _gravity_fault(self, q: np.ndarray, residual: np.ndarray) -> Fault | None:
        """Fault of an arm whose driver adds g(q) though it should not, or does not; or None."""
        gravity = self._arm.gravity(q)
        share = float(residual.dot(gravity)) / max(float(gravity.dot(gravity)), 1e-9)
        left = np.abs(residual - share * gravity)
        if abs(share) < GRAVITY_SHARE or (left > self._explainable).any():
            return None
        self._gravity_wrong = True
        text, meant = ("twice, also by the driver", "true") if share > 0 else ("by nobody", "false")
        return Fault(
            FaultKind.EXTERNAL_TORQUE,
            f"gravity is compensated {text}: is driver_compensates_gravity: {meant} meant?",
        )

    def limit_fault(self, mode: Mode, state: JointState, motion: Motion | Speeds) -> Fault | None:
        """Fault of a motion beyond the limits of the mode, or None."""
        return self._motion.fault(mode, state, motion)

    def missing(self, last: JointState, dt: float) -> JointState:
        """State of the arm by its model while none is received, see `Reaction.missing`."""
        return self.reaction.missing(last, self.believed, dt)

    def reaction_torque(self, state: JointState, motion: Motion | Speeds) -> np.ndarray:
        """Motor torque in a fault [N m], shape (n,); see `Reaction.torque`."""
        plausible = self._plausibility.implausible_ns != state.stamp_ns
        if not isinstance(motion, Motion) or safety.rest_violation(motion) or not plausible:
            self._rest_since_ns = None
        elif self._rest_since_ns is None:
            self._rest_since_ns = state.stamp_ns
        weight = np.array(self._plausibility.residual) if self._gravity_wrong else self._weight
        explained = self.believed and not (self._suspect and self._unexplained)
        tau = self.reaction.torque(state, self.believed, explained, weight)
        if self._lasting:
            return tau
        if self._falls(state):
            error = self._plausibility.residual if self._weight is None else self._weight
            self.reaction.follow(state.q, -np.array(error))
            self.believed, self._explained, self._suspect = True, 0, False
        elif not self.believed:
            agrees = self._agrees(state.q - self.reaction.posture)
            rests = self._rest_since_ns is not None
            if self._contradicted:
                self.believed = agrees and not self._drifts
            else:
                self.believed = agrees and rests and self._explains
        return tau

    def _falls(self, state: JointState) -> bool:
        """Whether states have long reported an arm that falls, ever faster as the torques explain.

        A drift at a constant speed is explained as well, and so is an answer to the brake: neither
        goes on changing its speed. With a false zero gravity is false, too.
        """
        speeds, residual = self.reaction.reported(), np.array(self._plausibility.residual)
        if np.abs(speeds).max() < SLIDING:
            self._at_rest = residual
        near = self._explains or (np.abs(residual - self._at_rest) <= self._explainable).all()
        near |= self.reaction.alone and not self.believed
        if not (self.reaction.settled and near):
            self._explained = min(self._explained, 0)
            return False
        if self._weight is not None:  # not one that only an acceleration makes so heavy
            least = np.maximum(self._arm.friction, FALL_SHARE * np.abs(self._weight))
            return self.reaction.frozen and bool((np.abs(residual) > least).sum() > 1)
        if self._explained <= 0:
            self._fall = speeds, residual, np.zeros(self._arm.n)
        begun, usual, impulse = self._fall
        self._fall = begun, usual, impulse + state.span * (residual - usual)
        self._explained += 1
        if self._explained <= self._fall_states:
            return False
        joint = int(np.abs(speeds - begun).argmax())
        momentum = self._arm.mass_matrix(state.q)[joint].dot(speeds - begun)
        if abs(impulse[joint]) > FALL_SHARE * abs(momentum):
            self._explained = 0
            return False
        return bool(np.abs(speeds).max() > np.abs(begun).max() + FALL_SPEED)

    def _agrees(self, difference: np.ndarray) -> bool:
        """Whether reported minus predicted position (n,) [rad] has long stayed the same."""
        begun = self._agreed_from
        if not self._agreed or begun is None or np.abs(difference - begun).max() > AGREEMENT:
            self._agreed, self._agreed_from = 0, difference
        self._agreed += 1
        return self._agreed > self._belief_states

    def rested(self, stamp_ns: int) -> bool:
        """Whether the arm has been at rest for `REST_NS`, in plausible states."""
        return self._rest_since_ns is not None and stamp_ns - self._rest_since_ns >= REST_NS
