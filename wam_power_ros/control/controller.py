# SPDX-License-Identifier: Apache-2.0
"""Torque controller: one torque per joint state, and an explicit state machine of modes.

It reads no clock: time comes from the stamps of the states. It uses no random numbers: the torques
depend only on the sequence of states and calls. While an arm at rest repeats its state, the torque
converges to a fixed point bit for bit, so a rollout that begins there does not depend on what
happened before.

Whatever raises (a singular matrix, a mistake in the code, no memory), the driver is not left with
the last torque: the exception latches a fault, and `BrakeWithoutModel` stops and holds the arm.
"""

import math
from collections import Counter
from collections.abc import Callable

import numpy as np

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm, Motion, Speeds
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.fault_hold import BrakeWithoutModel
from wam_power_ros.control.joint_control import JointControl, TrackingError, TrackingLost
from wam_power_ros.control.joint_references import Sampled
from wam_power_ros.control.modes import (
    PASSIVE_MODES,
    REFERENCE_MODES,
    SWITCH_MODES,
    ControllerError,
    Mode,
    Refusal,
    check_transition,
)
from wam_power_ros.control.policy_execution import Execution
from wam_power_ros.control.policy_preparation import prepare
from wam_power_ros.control.state_checks import STATE_LOSS_TIMEOUT, JointState, StateChecks, at_rate
from wam_power_ros.control.supervision import REST_NS, Supervision
from wam_power_ros.control.torque_output import TorqueOutput
from wam_power_ros.control.unexplained_torque import UnexplainedTorque
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.dmp import TabulatedPolicy
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import EndEffectorPath

Law = Callable[[JointState, Motion | Speeds], np.ndarray]

OBSERVED_STATES = 5  # states, at 500 Hz, from one measurement of the unexplained torque to the next
STANDSTILL = 0.05  # [rad/s] largest joint speed of an arm at rest, where no tool speed is known


class Controller:
    """Computes torques from joint states. Not thread-safe: call it from one thread.

    Attributes:
        counters: Number of states `accepted`, `repeated`, `older`, `rejected`; of `gaps`, `jumps`;
            of torques `limited` and `stale`; of `faults`.
        latched: Latched fault, None without one.
        fresh: Whether the last state was accepted as a new one.
        unexplained: Torque beyond the model that held the arm at rest.
        enabled: Whether a person holds the enabling switch that `hold_to_run` requires; the caller
            sets it before every state.
        error: Last exception of a computation, until `take_error`; None without one.

    Args:
        latched: Fault that a previous controller had latched; only a reset clears it.

    Raises:
        ValueError: The settings do not match the arm.
    """

    def __init__(
        self, arm: Arm, settings: ControllerSettings | None = None, latched: Fault | None = None
    ) -> None:
        settings = settings or ControllerSettings()
        self.arm = arm
        self.limits = settings.limits or safety.limits_of(arm)
        self.settings = settings.model_copy(update={"limits": self.limits})
        if (n := self.limits.torque.size) != arm.n:
            raise ValueError(f"limits are for {n} joints, the arm has {arm.n}")
        self.latched = latched
        self.enabled = self.fresh = False
        self.error: Exception | None = None

        self._observed_states = at_rate(OBSERVED_STATES, settings.period)
        self._states = StateChecks(arm.n, settings.period, settings.velocity_cutoff, arm.qd_max)
        self.counters: Counter[str] = self._states.counters
        compensated = settings.driver_compensates_gravity
        self._output = TorqueOutput(arm, self.limits, compensated, self.counters)
        self._supervision = Supervision(arm, self.limits, settings, self._output.motor_torque)
        self._joints = JointControl(arm, self.limits)
        self._policy: TabulatedPolicy | None = None  # loaded
        self._rollout: Execution | None = None  # the last that began
        self._completed: set[str] = set()  # contents of policies that have run to their end
        self.unexplained = UnexplainedTorque(arm)
        self._brake = BrakeWithoutModel(arm, compensated, settings.period)
        self._failed = False  # no torque could be computed for the last state
        self._springs = safety.LimitSprings(self.limits)
        self._unanswered = 0.0  # time since the last state that stale torques have used [s]
        self._lockstep = False  # the stamps are the only clock
        self._held_states = 0  # since the last measurement of the unexplained torque
        self._laws: dict[Mode, Law] = {
            Mode.INACTIVE: self._braking_torque,
            Mode.GRAVITY_COMPENSATION: self._teaching_torque,
            Mode.HOLD: self._joint_torque,
            Mode.MOVE_TO_START: self._joint_torque,
            Mode.ROLLOUT: self._rollout_torque,
            Mode.REPLAY: self._joint_torque,
            Mode.FAULT: self._supervision.reaction_torque,
        }
        self._law: Law = self._braking_torque
        self._set(Mode.INACTIVE if latched is None else Mode.FAULT)
        self._label = self._mode_label

    # Status

    @property
    def mode(self) -> Mode:
        """Present mode; a request changes it at once."""
        return self._mode

    @property
    def label(self) -> str:
        """Mode of the last torque; in a rollout with the policy's id ("rollout trial-0007")."""
        return self._label

    @property
    def stamp_ns(self) -> int | None:
        """Stamp of the last accepted state [ns], None before the first."""
        return None if self._states.last is None else self._states.last.stamp_ns

    @property
    def refusal(self) -> str:
        """Why the last state that was refused for its values was refused; empty before it."""
        return self._states.refusal

    @property
    def policy_id(self) -> str | None:
        """Id of the loaded policy, None before the first."""
        return None if self._policy is None else self._policy.id

    @property
    def rollout_stamp_ns(self) -> int | None:
        """Stamp of the first state of the last ended rollout [ns]; None during one."""
        rollout = self._rollout
        return None if rollout is None or rollout.under_way else rollout.start_ns

    @property
    def stopped_in(self) -> str:
        """Name of the guarded region that ended the last rollout; "" if none did."""
        return "" if self._rollout is None else self._rollout.stopped_in

    @property
    def at_rest(self) -> bool:
        """Whether the arm was at rest in the last state."""
        try:
            return not self._rest_violation()
        except Exception as error:
            self.error, last = error, self._states.last
            return last is not None and float(np.abs(last.qd).max()) < STANDSTILL

    @property
    def ready(self) -> bool:
        """Whether `execute` would begin a rollout: the arm holds the policy's start, at rest."""
        try:
            self._require_ready()
        except ControllerError:
            return False
        return True

    @property
    def replay_error(self) -> TrackingError | None:
        """Tracking error of the last replay so far; None before the first."""
        return self._joints.replay_error

    def take_finished(self) -> EndEffectorPath | None:
        """Return the path of the last finished or aborted rollout, once; then None."""
        return None if self._rollout is None else self._rollout.take_path()

    def take_error(self) -> Exception | None:
        """Return the last exception, once; then None."""
        error, self.error = self.error, None
        return error

    # Requests

    def load(self, policy: Policy) -> None:
        """Load the policy to execute: check it and compute its tables.

        Raises:
            ControllerError: A rollout is under way, or the policy does not fit the arm.
        """
        self.load_prepared(prepare(policy, self.limits, self.settings))

    def load_prepared(self, policy: TabulatedPolicy) -> None:
        """Load a policy that `prepare` returned for this arm and these settings.

        Raises:
            ControllerError: A rollout is under way.
        """
        if self._mode is Mode.ROLLOUT:
            raise ControllerError(Refusal.BUSY, f"policy {policy.id} refused during a rollout")
        self._policy = policy

    def hold(self) -> None:
        """Abort any motion, brake and hold the posture.

        Raises:
            ControllerError: A fault is latched, no joint state has been received, or no torque
                could be computed for the last one, or none within the limits carries the arm.
        """
        self._require_torque("hold")
        if self._mode is not Mode.HOLD:
            self._enter(Mode.HOLD)

    def stop(self) -> None:
        """Abort any motion and hold; no effect when inactive or in a fault."""
        if self._mode not in PASSIVE_MODES:
            try:
                self.hold()
            except Exception as error:  # the motion cannot be ended as usual
                self._fault_of(error)

    def release(self) -> None:
        """While holding, only compensate gravity and damp motion, until the mode changes."""
        if self._mode is Mode.HOLD:
            self._law = self._braking_torque

    def set_gravity_compensation(self, on: bool) -> None:
        """Begin gravity compensation, so that a person can guide the arm, or end it and hold.

        It begins with the torque that held the arm: what the model does not explain is added to
        g(q), so that an arm that nobody touches stays.

        Raises:
            ControllerError: The arm moves by itself, a fault is latched, the enabling switch is not
                held, the arm has not been held at rest yet, or the torque that holds it is not
                explained by model and friction.
        """
        if not on and self._mode not in (Mode.GRAVITY_COMPENSATION, Mode.HOLD):
            check_transition(self._mode, Mode.HOLD, self.latched)  # names a fault
            text = f"gravity compensation is not on: mode is {self._mode.value}"
            raise ControllerError(Refusal.BUSY, text)
        if on and self._mode is not Mode.GRAVITY_COMPENSATION:
            self._require_switch(Mode.GRAVITY_COMPENSATION)
            self._require_explained()
            self._enter(Mode.GRAVITY_COMPENSATION)
        elif not on and self._mode is Mode.GRAVITY_COMPENSATION:
            self._enter(Mode.HOLD)

    def move_to_start(self) -> None:
        """Move all joints to the policy's start at limited speed, then hold.

        Raises:
            ControllerError: No policy is loaded, the arm moves, or the mode does not allow it.
        """
        self._move(Mode.MOVE_TO_START, self._require_policy("move_to_start").q_start)

    def start_replay(self, movement: Sampled) -> None:
        """Move to the start of a recorded joint movement, then follow it, then hold.

        Args:
            movement: Movement that `replay_trajectory.sampled` has checked for this arm.

        Raises:
            ControllerError: The arm moves, the mode does not allow it, or the enabling switch is
                not held.
        """
        self._require_switch(Mode.REPLAY)
        self._move(Mode.REPLAY, movement.q[0], movement)

    def execute(self) -> None:
        """Begin a rollout of the loaded policy with the next state.

        Raises:
            ControllerError: The arm is not ready; the message says why.
        """
        policy = self._require_ready()
        self._require_switch(Mode.ROLLOUT)
        rollout = Execution(policy, self.arm, self.settings)
        self._enter(Mode.ROLLOUT)
        self._rollout, self._mode_label = rollout, f"rollout {policy.id}"

    def fault(self, fault: Fault) -> None:
        """Latch a fault and abort any motion; no effect when inactive or in a fault."""
        if self._mode in PASSIVE_MODES:
            return
        self.latched = fault
        self.counters["faults"] += 1
        mode = self._mode
        try:
            self._enter(Mode.FAULT)
        except Exception as error:  # the path of the rollout is lost
            self.error = error
            self._set(Mode.FAULT)
        try:
            self._supervision.faulted(mode, fault.kind, self.unexplained)
        except Exception as error:  # without a model: `BrakeWithoutModel` answers the next states
            self.error = error

    def reset(self) -> None:
        """Clear the latched fault and hold.

        Raises:
            ControllerError: No fault is latched, the arm moves, the joint states are not valid or
                not plausible, or `hold` would be refused.
        """
        self._require_torque("reset")
        if self._mode is not Mode.FAULT:
            text = f"reset refused: no fault, mode is {self._mode.value}"
            raise ControllerError(Refusal.NOTHING, text)
        if self._states.refused_in_row:
            text = "reset refused: the last joint state was not valid"
            raise ControllerError(Refusal.REFUSED, text)
        self._require_rest("reset")
        last = self._states.last
        if last is None or not self._supervision.rested(last.stamp_ns):
            text = f"reset refused: the arm must be at rest for {REST_NS * 1e-9:.1f} s, with joint"
            raise ControllerError(Refusal.BUSY, f"{text} states that pass the plausibility checks")
        self._enter(Mode.HOLD, reset=True)
        self.latched = None
        self._supervision.begin()
        model_error = self._output.motor_torque(last.q) - self.arm.gravity(last.q)
        self.unexplained.assume(last.q, model_error)

    def deactivate(self) -> None:
        """Abort any motion; the caller must send no torque from now on. A fault stays latched."""
        if self._mode not in PASSIVE_MODES:
            self._enter(Mode.INACTIVE)

    def _enter(self, mode: Mode, reset: bool = False) -> None:
        """Change the mode and end the rollout or reference of the old one."""
        check_transition(self._mode, mode, self.latched, reset)
        last = self._states.last
        if last is None and mode is not Mode.INACTIVE:
            text = f"{mode.value} refused: no joint state has been received yet"
            raise ControllerError(Refusal.NOTHING, text)
        if self._rollout is not None and last is not None:
            self._rollout.end(last)
        if self._mode is Mode.INACTIVE:
            self._supervision.begin()
            self.unexplained.begin()
        if mode not in REFERENCE_MODES:
            self._joints.release()
        self._set(mode)
        self._joints.begin()
        self._supervision.mode_changed()

    def _set(self, mode: Mode) -> None:
        self._mode, self._law, self._mode_label = mode, self._laws[mode], mode.value
        if mode is Mode.HOLD:
            self.unexplained.rest_again()

    def _move(self, mode: Mode, goal: np.ndarray, *then: Sampled) -> None:
        self._require_rest(mode.value)
        self._enter(mode)
        self._joints.move(goal, self.settings.move_speed, *then)

    # Preconditions of requests

    def _lacks_switch(self, mode: Mode) -> bool:
        """Whether this mode requires the enabling switch and it is not held."""
        if self.enabled or not self.settings.hold_to_run or mode not in SWITCH_MODES:
            return False
        completed = self._policy is not None and self._policy.content in self._completed
        return mode is not Mode.ROLLOUT or not completed

    def _require_switch(self, mode: Mode) -> None:
        if self._lacks_switch(mode):
            text = f"{mode.value} refused: the enabling switch is not held"
            raise ControllerError(Refusal.SWITCH, text)

    def _require_torque(self, request: str) -> None:
        """Refuse to take the arm over without a torque that carries it."""
        if self._mode not in PASSIVE_MODES or (last := self._states.last) is None:
            return
        failed = "no torque could be computed for the last joint state" if self._failed else ""
        if text := failed or self._output.too_heavy(last.q):
            raise ControllerError(Refusal.REFUSED, f"{request} refused: {text}")

    def _require_explained(self) -> None:
        """Refuse to hand the arm to a person when the model does not carry it."""
        if self._mode is not Mode.HOLD:
            return
        name = Mode.GRAVITY_COMPENSATION.value
        if not self.unexplained.known:
            text = f"{name} refused: the arm has not been held at rest for a moment yet"
            raise ControllerError(Refusal.BUSY, text)
        if excess := self.unexplained.excess():
            text = f"{name} refused: the arm would not stay where it is left; {excess}"
            raise ControllerError(Refusal.REFUSED, f"{text}: check payload, zeros, base and motors")

    def _require_rest(self, request: str) -> None:
        if reason := self._rest_violation():
            refusal = Refusal.NOTHING if self._states.last is None else Refusal.BUSY
            raise ControllerError(refusal, f"{request} refused: {reason}")

    def _rest_violation(self) -> str:
        """Reason why the arm is not at rest; empty when it is."""
        if (last := self._states.last) is None:
            return "no joint state has been received yet"
        return safety.rest_violation(self.arm.motion(last.q, last.qd))

    def _require_policy(self, request: str) -> TabulatedPolicy:
        if self._policy is None:
            raise ControllerError(Refusal.NOTHING, f"{request} refused: no policy is loaded")
        return self._policy

    def _require_ready(self) -> TabulatedPolicy:
        """Return the loaded policy; refuse a rollout that cannot begin now."""
        if self.latched is not None:
            text = f"rollout refused: fault ({self.latched.text}); reset first"
            raise ControllerError(Refusal.FAULT, text)
        policy = self._require_policy("rollout")
        last = self._states.last
        if self._mode is not Mode.HOLD or last is None:
            text = f"rollout refused: mode is {self._mode.value}, not hold"
            raise ControllerError(Refusal.BUSY, text)
        self._require_rest("rollout")
        error, tolerance = np.abs(last.q - policy.q_start), self.settings.start_tolerance
        worst = int(np.argmax(error))
        if error[worst] > tolerance:
            joint = f"{self.arm.joint_names[worst]} is {error[worst]:.3f} rad from the start"
            text = f"rollout refused: {joint} of policy {policy.id}, tolerance {tolerance:g}"
            raise ControllerError(Refusal.NOT_AT_START, text)
        return policy

    # Control cycle

    def step(
        self,
        stamp_ns: int,
        q: np.ndarray,
        qd: np.ndarray | None,
        elapsed: float | None = None,
        since_sent: float | None = None,
    ) -> np.ndarray:
        """Compute the torque for one joint state.

        It is finite, within the torque limits and, unless inactive, within the limits of the torque
        rate. A repeated stamp gets the same array again; an older or invalid state is counted and
        changes nothing: `fresh` is False for both.

        Args:
            stamp_ns: Stamp of the driver's header [ns].
            q: Joint positions [rad]. Shape (n,).
            qd: Joint speeds, None when the driver does not send them [rad/s]. Shape (n,).
            elapsed: Time since the last accepted state by the caller's clock, None to use the
                stamps [s]. The model of the arm in a fault depends on it.
            since_sent: Time since the last torque was sent by the caller's clock, which the torque
                rate limit depends on; None for what is left of `elapsed` after the times of
                `stale_torque` [s].

        Returns:
            [N m], read-only. Shape (n,).
        """
        before = self._output.sent
        try:
            tau = _finite(self._answer(stamp_ns, q, qd, elapsed, since_sent))
            if self.fresh and (last := self._states.last) is not None:
                self._brake.observe(self.arm, last.q, self.unexplained.compensation)
        except Exception as error:
            self.fresh = True  # it is answered
            state = self._states.last
            if state is not None and state.stamp_ns != stamp_ns:
                state = None
            since = elapsed if since_sent is None else since_sent
            return self._answer_without_model(error, before, state, since)
        if self.fresh and self._failed:
            self._failed = False
            self._brake.end()
        return tau

    def _answer(
        self,
        stamp_ns: int,
        q: np.ndarray,
        qd: np.ndarray | None,
        elapsed: float | None,
        since_sent: float | None,
    ) -> np.ndarray:
        """Check a state and compute its torque, see `step`; may raise anything."""
        states = self._states
        state = states.take(stamp_ns, q, qd, self._mode in PASSIVE_MODES, elapsed)
        if (fault := states.fault) is not None:
            if self._mode is Mode.FAULT:
                self._supervision.doubt(fault.kind)
            self.fault(fault)
        self.fresh = state is not None
        if state is None:
            return self._output.sent
        self._lockstep = elapsed is None
        left = max(0.0, state.dt - self._unanswered) if since_sent is None else since_sent
        self._unanswered = 0.0
        return self._checked_torque(state, min(left, 2.0 * self.settings.period))

    def refuse_state(self) -> None:
        """Count an unreadable joint state as refused."""
        self._states.refuse()
        if (fault := self._states.fault) is not None:
            self.fault(fault)

    def stale_torque(self, elapsed: float | None = None) -> np.ndarray:
        """Compute the torque to send while joint states are missing: it brakes and carries the arm.

        The model predicts the arm's state from earlier states and torques; if it cannot, gravity of
        an earlier posture is carried. Before the first state the torque is zero.

        Args:
            elapsed: Time since the last state or the last torque, whichever is later [s]; None for
                one period.

        Returns:
            [N m], read-only. Shape (n,).
        """
        self.counters["stale"] += 1
        if (last := self._states.last) is None:
            return self._output.sent
        dt = self.settings.period if elapsed is None else min(elapsed, STATE_LOSS_TIMEOUT)
        self._unanswered += dt
        before = self._output.sent
        try:
            state = self._supervision.missing(last, dt)
            dt = min(dt, 2.0 * self.settings.period)
            if self._mode is Mode.FAULT:
                tau = self._supervision.reaction.without_state(state)
            else:
                tau = self._braking_torque(state)
            return _finite(self._send(self._with_springs(tau, state.q, dt), state.q, dt))
        except Exception as error:
            return self._answer_without_model(error, before, None, elapsed)

    def _answer_without_model(
        self, error: Exception, before: np.ndarray, state: JointState | None, elapsed: float | None
    ) -> np.ndarray:
        """Latch a fault; returns the torque (n,) [N m] to send a time [s] after `before`."""
        self._failed = True
        self._fault_of(error)
        self._supervision.begin()  # it does not see what happens meanwhile
        dt = self.settings.period if elapsed is None else min(elapsed, self.settings.period)
        tau = self._brake.torque(state, dt)
        if tau is None or self._mode is Mode.INACTIVE:
            tau = before
        elif state is not None:
            tau = self._with_springs(tau, state.q, dt)
        sent = safety.limit_torque(tau, before, dt, self.limits)
        sent.setflags(write=False)
        self._output.sent, self._label = sent, self._mode_label
        return sent

    def _fault_of(self, error: Exception) -> None:
        self.error = error
        self.fault(Fault(FaultKind.COMPUTATION, f"no torque could be computed: {error!r}"))

    def _send(self, tau: np.ndarray, q: np.ndarray, dt: float) -> np.ndarray:
        return self._output.send(tau, q, None if self._mode is Mode.INACTIVE else dt)

    def _checked_torque(self, state: JointState, dt: float) -> np.ndarray:
        """Torque for an accepted state, after all checks, a time [s] after the last was sent."""
        supervision = self._supervision
        fault = supervision.plausibility_fault(self._mode, self._states.before, state)
        if fault is not None:
            self.fault(fault)
        # Holding needs the speeds only.
        motion = (self.arm.speeds if self._mode is Mode.HOLD else self.arm.motion)(
            state.q, state.qd
        )
        if (fault := supervision.limit_fault(self._mode, state, motion)) is not None:
            self.fault(fault)
        if self.settings.hold_to_run and self._lacks_switch(self._mode):
            self.fault(Fault(FaultKind.RELEASED, "the enabling switch was released"))
        if self._mode is not Mode.FAULT:
            supervision.reaction.end()
        tau = self._torque(state, motion)
        q = supervision.reaction.posture if self._mode is Mode.FAULT else state.q
        sent = self._send(self._with_springs(tau, q, state.span), q, dt)
        self._label = self._mode_label
        return sent

    def _torque(self, state: JointState, motion: Motion | Speeds) -> np.ndarray:
        """Torque of the mode before limiting; latches a fault when it cannot be computed."""
        fault = None
        try:
            tau = self._law(state, motion)
            if not math.isfinite(sum(tau.tolist())):
                fault = Fault(FaultKind.COMPUTATION, "the torque was not finite")
        except TrackingLost as error:
            fault = Fault(error.kind, str(error))
        except Exception as error:  # whatever it is, the arm needs a torque in this period
            fault = Fault(FaultKind.COMPUTATION, f"no torque could be computed: {error}")
        if fault is not None:
            self.fault(fault)
            tau = self._law(state, motion)
        return tau

    def _with_springs(self, tau: np.ndarray, q: np.ndarray, dt: float) -> np.ndarray:
        springs = self._springs.torque(q, dt)
        return tau if springs is None else tau + springs

    # Torque of each mode

    def _braking_torque(self, state: JointState, _: Motion | Speeds | None = None) -> np.ndarray:
        return self._damped_gravity(state, safety.FAULT_DAMPING, self.unexplained.compensation)

    def _teaching_torque(self, state: JointState, motion: Motion | Speeds) -> np.ndarray:
        before, step = self._states.before, 0.0
        if before is not None:
            step = float(np.abs(state.q - before.q - state.span * state.qd).max())
        offset = self.unexplained.teaching_offset(state.q, step)
        if self._lockstep:  # a demonstration in simulation may not depend on the hold before it
            offset = self.unexplained.compensation
        tau = self._damped_gravity(state, safety.teaching_damping(motion.tool_speed), offset)
        if not (share := self.settings.teaching_friction):
            return tau
        arm = self.arm
        relief = safety.friction_relief(arm.friction, arm.asymmetry, arm.damping, state.qd)
        return tau + share * relief

    def _damped_gravity(self, state: JointState, damping: float, error: np.ndarray) -> np.ndarray:
        """g(q) and a torque beyond the model; all motion decays at a rate [1/s]. [N m], (n,).

        The product of the rate and the delay of the loop must stay well below pi / 2.
        """
        braking = damping * self.arm.mass_matrix(state.q).dot(state.qd)
        return self.arm.gravity(state.q) + error - braking

    def _joint_torque(self, state: JointState, motion: Motion | Speeds) -> np.ndarray:
        tau = self._joints.torque(state.stamp_ns, state.q, state.qd)
        if self._mode is not Mode.HOLD and self._joints.holding:
            self._set(Mode.HOLD)
        self._held_states += 1
        if self._held_states >= self._observed_states and self._mode is Mode.HOLD:
            self._held_states = 0
            at_rest = max(*motion.guarded_speeds, motion.tool_speed) < safety.REST_SPEED
            model_error = self._output.motor_torque(state.q) - self.arm.gravity(state.q)
            dt = self._observed_states * self.settings.period
            self.unexplained.observe(at_rest, state.q, state.qd, model_error, dt)
            if self.unexplained.crept:
                self.fault(Fault(FaultKind.DRIFT, self.unexplained.crept))
                self.unexplained.rest_again()
                return self._law(state, motion)
        return tau

    def _rollout_torque(self, state: JointState, motion: Motion | Speeds) -> np.ndarray:
        if not isinstance(motion, Motion):
            raise TypeError("a rollout needs the position of the tool")
        if (rollout := self._rollout) is None or not rollout.under_way:
            raise RuntimeError("no rollout is under way")
        if (tau := rollout.torque(state, motion)) is not None:
            return tau
        if rollout.complete and self._policy is not None:
            self._completed.add(self._policy.content)
        self._enter(Mode.HOLD)
        return self._joint_torque(state, motion)


def _finite(tau: np.ndarray) -> np.ndarray:
    """Return a torque (n,) [N m]; ArithmeticError unless every number is finite."""
    if not math.isfinite(sum(tau.tolist())):
        raise ArithmeticError(f"torque {tau.tolist()} is not finite")
    return tau
