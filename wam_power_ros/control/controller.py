# SPDX-License-Identifier: Apache-2.0
"""The torque controller: one torque per joint state, and an explicit machine of modes.

It has no clock: time is the stamps of the states. It has no randomness: the torques depend only on
the sequence of states and calls. While an arm at rest repeats its state, the torque reaches a fixed
point bit for bit (25 periods undo 25 N m): a rollout that begins there depends on nothing before.
"""

import math
from collections import Counter
from collections.abc import Callable

import numpy as np

from wam_power_ros.control import replay_trajectory, safety
from wam_power_ros.control.arm import Arm, Motion, Speeds
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.joint_control import JointControl
from wam_power_ros.control.joint_references import JointTrajectory, Sampled
from wam_power_ros.control.modes import (
    HELD,
    PASSIVE,
    REFERENCED,
    ControllerError,
    Mode,
    Refusal,
    check_transition,
)
from wam_power_ros.control.prepared_policy import PreparedPolicy, prepare
from wam_power_ros.control.rollouts import Rollouts
from wam_power_ros.control.state_checks import STATES_LOST_AFTER, JointState, StateChecks
from wam_power_ros.control.supervision import REST_NS, Supervision
from wam_power_ros.control.torque_output import TorqueOutput
from wam_power_ros.control.tracking_error import TrackingError, TrackingLost
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import EndEffectorPath, Fault, FaultKind

Law = Callable[[JointState, Motion | Speeds], np.ndarray]


class Controller:
    """Turns joint states into torques. Not thread-safe: calls come from one thread.

    Attributes:
        arm: Model of the arm.
        settings: Settings of the controller.
        limits: Limits of the arm.
        counters: Number of states `accepted`, `repeated`, `older`, `rejected`; of `gaps`, `jumps`;
            of torques `limited` and `stale`; of `faults`.
        latched: Fault that is latched, None without.
        fresh: True when the last state was accepted as a new one.
        enabled: Whether a person holds the enabling switch, where `hold_to_run` asks for one; set
            from outside, before every state.

    Args:
        arm: Model of the arm, used by this controller alone.
        settings: Settings of the controller.
        latched: Fault of a controller before this one, which only a reset ends.

    Raises:
        ValueError: The settings do not fit the arm.
    """

    def __init__(
        self,
        arm: Arm,
        settings: ControllerSettings | None = None,
        latched: Fault | None = None,
    ) -> None:
        self.settings = settings = settings or ControllerSettings()
        self.arm = arm
        self.limits = settings.limits or safety.limits_of(arm)
        if (n := self.limits.torque.size) != arm.n:
            raise ValueError(f"limits are for {n} joints, the arm has {arm.n}")
        self.latched = latched
        self.enabled = self.fresh = False

        self._states = StateChecks(arm.n, settings.period, settings.velocity_cutoff)
        self.counters: Counter[str] = self._states.counters
        compensated = settings.driver_compensates_gravity
        self._output = TorqueOutput(arm, self.limits, compensated, self.counters)
        self._supervision = Supervision(arm, self.limits, settings, self._output.acting)
        self._joints = JointControl(arm, self.limits)
        self._rollouts = Rollouts(arm, settings)
        self._laws: dict[Mode, Law] = {
            Mode.INACTIVE: self._rest_torque,
            Mode.GRAVITY_COMPENSATION: self._teaching_torque,
            Mode.HOLD: self._joint_torque,
            Mode.MOVE_TO_START: self._joint_torque,
            Mode.ROLLOUT: self._rollout_torque,
            Mode.REPLAY: self._joint_torque,
            Mode.FAULT: self._rest_torque,
        }
        self._law: Law = self._rest_torque
        self._set(Mode.INACTIVE if latched is None else Mode.FAULT)
        self._label = self._mode_label

    # What a caller may see

    @property
    def mode(self) -> Mode:
        """Present mode; a request changes it at once."""
        return self._mode

    @property
    def label(self) -> str:
        """Mode of the last torque, and for a rollout the id ("rollout trial-0007")."""
        return self._label

    @property
    def stamp_ns(self) -> int | None:
        """Stamp of the last state that was accepted, None before the first [ns]."""
        return None if self._states.last is None else self._states.last.stamp_ns

    @property
    def policy_id(self) -> str | None:
        """Id of the policy that is loaded."""
        return None if self._rollouts.policy is None else self._rollouts.policy.id

    @property
    def rollout_stamp_ns(self) -> int | None:
        """Stamp of the first state of the last rollout that ended, None before it [ns]."""
        return self._rollouts.start_ns

    @property
    def at_rest(self) -> bool:
        """Whether the arm was at rest in the last state."""
        return not self._unrest()

    @property
    def ready(self) -> bool:
        """Whether `execute` would begin: holding at the policy's start, at rest."""
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
        """Return the path of the rollout that has ended, once; shorter when it was cut short."""
        return self._rollouts.take_path()

    # Requests

    def load(self, policy: Policy) -> None:
        """Make a policy the one to execute; all tables are computed here.

        Raises:
            ControllerError: During a rollout, or when the policy does not fit the arm.
        """
        self.load_prepared(prepare(policy, self.arm.n, self.limits, self.settings))

    def load_prepared(self, policy: PreparedPolicy) -> None:
        """Make a policy the one to execute that was prepared for this arm and these settings.

        Raises:
            ControllerError: During a rollout.
        """
        if self._mode is Mode.ROLLOUT:
            raise ControllerError(Refusal.BUSY, f"policy {policy.id} refused during a rollout")
        self._rollouts.policy = policy

    def hold(self) -> None:
        """Come to rest and hold the posture; aborts what is under way.

        Raises:
            ControllerError: In a fault, or before the first state.
        """
        if self._mode is not Mode.HOLD:
            self._enter(Mode.HOLD)

    def stop(self) -> None:
        """Abort what is under way and hold; without effect when inactive or in a fault."""
        if self._mode not in PASSIVE:
            self.hold()

    def release(self) -> None:
        """Carry an arm that holds, without a spring, until the mode changes."""
        if self._mode is Mode.HOLD:
            self._law = self._rest_torque

    def set_gravity_compensation(self, on: bool) -> None:
        """Let a person move the arm, or hold it where it is.

        Raises:
            ControllerError: While the arm moves by itself, in a fault, or without the switch.
        """
        if on and self._mode is not Mode.GRAVITY_COMPENSATION:
            self._require_switch(Mode.GRAVITY_COMPENSATION)
            self._enter(Mode.GRAVITY_COMPENSATION)
        elif not on and self._mode is Mode.GRAVITY_COMPENSATION:
            self._enter(Mode.HOLD)

    def move_to_start(self) -> None:
        """Move all joints to the policy's start at limited speed, then hold there.

        Raises:
            ControllerError: Without a policy, while moving, or in a mode that does not allow it.
        """
        self._move(Mode.MOVE_TO_START, self._rollouts.loaded("move_to_start").q_start)

    def start_replay(self, trajectory: JointTrajectory, speed: float = 1.0) -> None:
        """Move to the start of a recorded joint movement, then follow it, then hold.

        Args:
            trajectory: Movement; see `replay_trajectory.sampled`.
            speed: 1 for as recorded, 0.5 for half of that.

        Raises:
            ControllerError: While moving, in a mode that does not allow it, or when the movement is
                not within the arm's limits.
        """
        period, limits = self.settings.period, self.limits
        self.start_sampled(replay_trajectory.sampled(trajectory, speed, period, limits))

    def start_sampled(self, movement: Sampled) -> None:
        """As `start_replay`, for a movement of `replay_trajectory.sampled` for this arm.

        Raises:
            ControllerError: While moving, or in a mode that does not allow it.
        """
        self._require_switch(Mode.REPLAY)
        self._move(Mode.REPLAY, movement.q[0], movement)

    def execute(self) -> None:
        """Begin a rollout of the loaded policy with the next state.

        Raises:
            ControllerError: The arm is not ready, with the reason.
        """
        self._require_ready()
        self._require_switch(Mode.ROLLOUT)
        self._enter(Mode.ROLLOUT)
        self._rollouts.begin()

    def fault(self, fault: Fault) -> None:
        """Latch a fault and abort what is under way; without effect when inactive or in a fault."""
        if self._mode in PASSIVE:
            return
        self.latched = fault
        self.counters["faults"] += 1
        self._supervision.faulted()
        self._enter(Mode.FAULT)

    def reset(self) -> None:
        """Leave a fault and hold.

        Raises:
            ControllerError: Without a fault, while the arm moves, or without valid joint states.
        """
        if self._mode is not Mode.FAULT:
            text = f"reset refused: no fault, mode is {self._mode.value}"
            raise ControllerError(Refusal.NOTHING, text)
        if self._states.refused_in_row:
            text = "reset refused: the last joint state was not valid"
            raise ControllerError(Refusal.REFUSED, text)
        self._require_rest("reset")
        last = self._states.last
        if last is None or not self._supervision.rested(last.stamp_ns):
            text = f"reset refused: the arm must be at rest for {REST_NS * 1e-9:.1f} s, in states"
            raise ControllerError(Refusal.BUSY, f"{text} that fit each other and the torques")
        self._enter(Mode.HOLD, reset=True)
        self.latched = None
        self._supervision.begin()

    def deactivate(self) -> None:
        """Abort what is under way; nothing may be sent any more. A fault stays latched."""
        if self._mode not in PASSIVE:
            self._enter(Mode.INACTIVE)

    def _enter(self, mode: Mode, reset: bool = False) -> None:
        """Change the mode, ending what the old one had under way."""
        check_transition(self._mode, mode, self.latched, reset)
        if self._states.last is None and mode is not Mode.INACTIVE:
            text = f"{mode.value} refused: no joint state has come yet"
            raise ControllerError(Refusal.NOTHING, text)
        self._rollouts.end(self._states.last)
        if self._mode is Mode.INACTIVE:
            self._supervision.begin()
        if mode not in REFERENCED:
            self._joints.release()
        self._set(mode)
        self._joints.begin()
        self._supervision.mode_changed()

    def _set(self, mode: Mode) -> None:
        self._mode, self._law, self._mode_label = mode, self._laws[mode], mode.value

    def _move(self, mode: Mode, goal: np.ndarray, *then: Sampled) -> None:
        self._require_rest(mode.value)
        self._enter(mode)
        self._joints.move(goal, self.settings.move_speed, *then)

    # Conditions of a request

    def _lacks_switch(self, mode: Mode) -> bool:
        """Whether the enabling switch must be held in this mode, and is not."""
        if self.enabled or not self.settings.hold_to_run or mode not in HELD:
            return False
        return mode is not Mode.ROLLOUT or not self._rollouts.tried

    def _require_switch(self, mode: Mode) -> None:
        if self._lacks_switch(mode):
            text = f"{mode.value} refused: the enabling switch is not held"
            raise ControllerError(Refusal.SWITCH, text)

    def _require_rest(self, request: str) -> None:
        if unrest := self._unrest():
            refusal = Refusal.NOTHING if self._states.last is None else Refusal.BUSY
            raise ControllerError(refusal, f"{request} refused: {unrest}")

    def _unrest(self) -> str:
        """Why the arm does not count as at rest; empty when it does."""
        if (last := self._states.last) is None:
            return "no joint state has come yet"
        return safety.unrest(self.arm.motion(last.q, last.qd))

    def _require_ready(self) -> None:
        """Refuse a rollout that cannot begin.

        Raises:
            ControllerError: The arm is not ready, with the reason.
        """
        if self.latched is not None:
            text = f"rollout refused: fault ({self.latched.text}); reset first"
            raise ControllerError(Refusal.FAULT, text)
        self._rollouts.loaded("rollout")
        last = self._states.last
        if self._mode is not Mode.HOLD or last is None:
            text = f"rollout refused: mode is {self._mode.value}, not hold"
            raise ControllerError(Refusal.BUSY, text)
        self._require_rest("rollout")
        self._rollouts.require_start(last.q)

    # Every state

    def step(
        self, stamp_ns: int, q: np.ndarray, qd: np.ndarray | None, elapsed: float | None = None
    ) -> np.ndarray:
        """The torque that answers one joint state.

        Finite, within the limits of size and, unless inactive, of change per second. The same
        stamp again gives the same array; a state that is older or not valid is counted and
        changes nothing: `fresh` is false for both.

        Args:
            stamp_ns: Stamp of the driver's header [ns].
            q: Joint positions [rad]. Shape (n,).
            qd: Joint speeds, None when the driver does not send them [rad/s]. Shape (n,).
            elapsed: Time since the last accepted state by a clock of the caller's, None to go by
                the stamps [s]. It bounds the change of the torque, and the arm is braked by it.

        Returns:
            [N m], read-only. Shape (n,).
        """
        states = self._states
        state = states.take(stamp_ns, q, qd, self._mode in PASSIVE, elapsed)
        if (fault := states.fault) is not None and not (
            fault.kind is FaultKind.JUMP and self._mode is Mode.GRAVITY_COMPENSATION
        ):  # while teaching nothing refers to a posture
            self.fault(fault)
        self.fresh = isinstance(state, JointState)
        if isinstance(state, JointState):
            return self._answer(state)
        return self._output.sent

    def refuse_state(self) -> None:
        """Count a joint state that could not be read, as `step` counts those it refuses."""
        self._states.refuse()
        if (fault := self._states.fault) is not None:
            self.fault(fault)

    def stale_torque(self, elapsed: float | None = None) -> np.ndarray:
        """The torque to send when no state has come: brakes and carries the arm on its model alone.

        The arm is taken to be where the model predicts it from the states and torques before.
        Without any state yet the torque is zero.

        Args:
            elapsed: Time since the last state or, after it, the last torque; one period if None
                [s].

        Returns:
            [N m], read-only. Shape (n,).
        """
        self.counters["stale"] += 1
        if (last := self._states.last) is None:
            return self._output.sent
        dt = self.settings.period if elapsed is None else min(elapsed, STATES_LOST_AFTER)
        state = self._supervision.without_state(last, dt)
        tau = self._with_springs(self._rest_torque(state), state.q)
        return self._send(tau, state.q, min(dt, 2.0 * self.settings.period))

    def _send(self, tau: np.ndarray, q: np.ndarray, dt: float) -> np.ndarray:
        return self._output.send(tau, q, None if self._mode is Mode.INACTIVE else dt)

    def _answer(self, state: JointState) -> np.ndarray:
        """The torque for a state that has been accepted."""
        mode, supervision = self._mode, self._supervision
        if (fault := supervision.doubt(mode, self._states.before, state)) is not None:
            self.fault(fault)
        # The position of the tool is not needed to hold.
        motion = (self.arm.speeds if self._mode is Mode.HOLD else self.arm.motion)(
            state.q, state.qd
        )
        if (fault := supervision.exceeded(self._mode, state, motion)) is not None:
            self.fault(fault)
        if self.settings.hold_to_run and self._lacks_switch(self._mode):
            self.fault(Fault(FaultKind.RELEASED, "the enabling switch was released"))
        if self._mode is Mode.FAULT:
            state = supervision.after_fault(state, motion, new=mode is not Mode.FAULT)
        else:
            supervision.trust()

        sent = self._send(self._torque(state, motion), state.q, state.dt)
        rollout = self._rollouts.present
        self._label = self._mode_label if rollout is None else f"rollout {rollout}"
        return sent

    def _torque(self, state: JointState, motion: Motion | Speeds) -> np.ndarray:
        """The torque of the mode, before the limits; a fault when that cannot be computed."""
        fault = None
        try:
            tau = self._law(state, motion)
            if not math.isfinite(sum(tau.tolist())):
                fault = Fault(FaultKind.COMPUTATION, "the torque was not finite")
        except TrackingLost as error:
            fault = Fault(FaultKind.TRACKING, str(error))
        except Exception as error:  # whatever it is, the arm needs a torque in this very tick
            fault = Fault(FaultKind.COMPUTATION, f"no torque: {error}")
        if fault is not None:
            self.fault(fault)
            tau = self._rest_torque(state, motion)
        return self._with_springs(tau, state.q)

    def _with_springs(self, tau: np.ndarray, q: np.ndarray) -> np.ndarray:
        springs = safety.limit_springs(q, self.limits)
        return tau if springs is None else tau + springs

    # The torque of each mode

    def _rest_torque(self, state: JointState, _: Motion | Speeds | None = None) -> np.ndarray:
        return self._carrying_torque(state, safety.FAULT_DAMPING)

    def _teaching_torque(self, state: JointState, motion: Motion | Speeds) -> np.ndarray:
        return self._carrying_torque(state, safety.teaching_damping(motion.tool_speed))

    def _carrying_torque(self, state: JointState, damping: float) -> np.ndarray:
        gravity, mass = self.arm.gravity(state.q), self.arm.mass_matrix(state.q)
        return safety.live_fallback(gravity, mass, state.qd, damping)

    def _joint_torque(self, state: JointState, _: Motion | Speeds) -> np.ndarray:
        tau = self._joints.torque(state.stamp_ns, state.q, state.qd)
        if self._mode is not Mode.HOLD and self._joints.holding:
            self._set(Mode.HOLD)
        return tau

    def _rollout_torque(self, state: JointState, motion: Motion | Speeds) -> np.ndarray:
        if not isinstance(motion, Motion):
            raise TypeError("a rollout needs the position of the tool")
        tau = self._rollouts.torque(state, motion)
        if tau is not None:
            return tau
        self._enter(Mode.HOLD)
        return self._joint_torque(state, motion)
