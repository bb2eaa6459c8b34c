# SPDX-License-Identifier: Apache-2.0
"""The torque controller: one torque per joint state, and an explicit machine of modes.

It has no clock: time is the stamps of the states. It has no randomness: the torques depend only on
the sequence of states and calls. While an arm at rest repeats its state, the torque reaches a fixed
point bit for bit (25 periods undo 25 N m): a rollout that begins there depends on nothing before.
"""

import math
from collections import Counter, deque
from collections.abc import Callable

import numpy as np

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm, Motion, Speeds
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.joint_references import Brake, Course, JointTrajectory, MinJerk, Sampled
from wam_power_ros.control.modes import (
    BOXED,
    HELD,
    MOVING,
    PASSIVE,
    REFERENCED,
    TRANSITIONS,
    ControllerError,
    Mode,
    Refusal,
)
from wam_power_ros.control.policy_execution import Execution
from wam_power_ros.control.safety import Stamp
from wam_power_ros.control.tracking_error import FollowingError, TrackingLost
from wam_power_ros.learning import dmp
from wam_power_ros.learning.policy import Policy, to_json, with_id
from wam_power_ros.learning.rollout import EndEffectorPath, Fault, FaultKind

_INTEGERS = (int, np.integer)


class Controller:
    """Turns joint states into torques. Not thread-safe: calls come from one thread.

    Attributes:
        counters: How many states were `accepted`, `repeated`, `older`, `rejected`, `gaps`, `jumps`;
            torques `limited` and `stale`; `faults`.
        latched: Fault that is latched, None without.
        replay_error: Of the last replay so far; None before the first.
        rollout_stamp_ns: Stamp of the first state of the last rollout that began, or None [ns].
        enabled: Whether a person holds the enabling switch, where `hold_to_run` asks for one; set
            from outside, before every state.

    Args:
        arm: Used by this controller alone.
        settings: Choices.

    Raises:
        ValueError: Settings that do not fit the arm.
    """

    def __init__(self, arm: Arm, settings: ControllerSettings | None = None) -> None:
        self.settings = settings = settings or ControllerSettings()
        self.arm = arm
        self.limits = settings.limits or safety.limits_of(arm)
        if self.limits.torque.shape != (arm.n,):
            raise ValueError(
                f"limits are for {self.limits.torque.size} joints, the arm has {arm.n}"
            )
        self._period_ns = round(settings.period * 1e9)
        self._laws: dict[Mode, Callable[[int, np.ndarray, np.ndarray, Motion], np.ndarray]] = {
            Mode.INACTIVE: self._rest_torque,
            Mode.GRAVITY_COMPENSATION: self._teaching_torque,
            Mode.HOLD: self._reference_torque,
            Mode.MOVE_TO_START: self._reference_torque,
            Mode.ROLLOUT: self._rollout_torque,
            Mode.REPLAY: self._reference_torque,
            Mode.FAULT: self._rest_torque,
        }
        self._set(Mode.INACTIVE)
        self._label = self._mode_label
        self.counters: Counter[str] = Counter()
        self.latched: Fault | None = None
        self.rollout_stamp_ns: int | None = None
        self.enabled = False

        # the last state accepted and the last torque sent
        self._stamp: int | None = None
        self._q: np.ndarray | None = None
        self._qd = np.zeros(arm.n)
        self._sent = np.zeros(arm.n)
        self._steps = 0
        self._rejections: deque[int] = deque(maxlen=5)  # the steps in which they came
        self._rejected_in_row = 0
        self._exceeded = 0  # states in a row beyond a motion limit

        self._course = Course(self._brake)
        self._ref: tuple[np.ndarray, np.ndarray] | None = None  # q_ref, qd_ref of the last state
        self.replay_error: FollowingError | None = None

        self._policy: Policy | None = None
        self._tables: dmp.Tables | None = None
        self._content = ""  # of the policy, whatever its id, where `hold_to_run` asks what is new
        self._tried: set[str] = set()  # contents that have run to their end once
        self._rollout: Execution | None = None
        self._finished: EndEffectorPath | None = None

    # ------------------------------------------------------------------ what a caller may see

    @property
    def mode(self) -> Mode:
        """The present mode; a request changes it at once."""
        return self._mode

    @property
    def label(self) -> str:
        """Goes with the last torque: its mode, and for a rollout the id ("rollout trial-0007")."""
        return self._label

    @property
    def stamp_ns(self) -> int | None:
        """Of the last state that was accepted, None before the first [ns]."""
        return self._stamp

    @property
    def policy_id(self) -> str | None:
        """Of the policy that is loaded."""
        return None if self._policy is None else self._policy.id

    @property
    def at_rest(self) -> bool:
        """Whether the arm was slower than `rest_speed` in the last state."""
        return self._unrest() is None

    @property
    def ready(self) -> bool:
        """Whether `execute` would begin: holding at the policy's start, at rest."""
        return self._unready() is None

    @property
    def tracking_error(self) -> np.ndarray | None:
        """q_ref - q [rad] in the last state, None when no joint reference is followed. (n,)."""
        return None if self._ref is None or self._q is None else self._ref[0] - self._q

    def take_finished(self) -> EndEffectorPath | None:
        """The path of the rollout that has ended, once; shorter when it was aborted."""
        path, self._finished = self._finished, None
        return path

    # ------------------------------------------------------------------------------- requests

    def load(self, policy: Policy) -> None:
        """Make a policy the one to execute; all tables are computed here.

        Raises:
            ControllerError: During a rollout, or when the policy does not fit the arm.
        """
        if self._mode is Mode.ROLLOUT:
            text = f"policy {policy.id} refused during a rollout"
            raise ControllerError(Refusal.BUSY, text)
        start, limits = policy.q_start, self.limits
        if start.shape != (self.arm.n,):
            raise ControllerError(
                Refusal.REFUSED,
                f"policy {policy.id} is for {start.size} joints, the arm has {self.arm.n}",
            )
        if np.any(start < limits.q_min) or np.any(start > limits.q_max):
            raise ControllerError(
                Refusal.REFUSED,
                f"q_start {start.round(3).tolist()} of policy {policy.id} is outside the limits "
                f"{limits.q_min.tolist()} to {limits.q_max.tolist()}",
            )
        stiffest = max(float(np.linalg.norm(k, 2)) for k in policy.stiffness)
        stiffest = max(stiffest, policy.rotation_stiffness)
        if stiffest > self.settings.stiffness_max:
            raise ControllerError(
                Refusal.REFUSED,
                f"stiffness {stiffest:.0f} of policy {policy.id} is above the limit "
                f"{self.settings.stiffness_max:.0f} 1/s^2",
            )
        self._tables = dmp.tabulate(policy, self.settings.period)
        self._policy = policy
        if self.settings.hold_to_run:
            self._content = to_json(with_id(policy, "content"))

    def hold(self) -> None:
        """Come to rest and hold the posture; aborts what is under way.

        Raises:
            ControllerError: In a fault.
        """
        if self._mode is not Mode.HOLD:
            self._enter(Mode.HOLD)

    def stop(self) -> None:
        """Abort what is under way and hold; without effect when inactive or in a fault."""
        if self._mode not in PASSIVE:
            self.hold()

    def set_gravity_compensation(self, on: bool) -> None:
        """Let a person move the arm, or hold it where it is.

        Raises:
            ControllerError: While the arm moves by itself, or in a fault.
        """
        if on and self._mode is not Mode.GRAVITY_COMPENSATION:
            self._ask_for_hand(Mode.GRAVITY_COMPENSATION)
            self._enter(Mode.GRAVITY_COMPENSATION)
        elif not on and self._mode is Mode.GRAVITY_COMPENSATION:
            self._enter(Mode.HOLD)

    def move_to_start(self) -> None:
        """Move all joints to the policy's start at limited speed, then hold there.

        Raises:
            ControllerError: Without a policy, while moving, or in a mode that does not allow it.
        """
        if self._policy is None:
            raise ControllerError(Refusal.NOTHING, "move_to_start refused: no policy is loaded")
        self._move(Mode.MOVE_TO_START, self._policy.q_start)

    def start_replay(self, trajectory: JointTrajectory, speed: float = 1.0) -> None:
        """Move to the start of a recorded joint movement, then follow it, then hold.

        Args:
            trajectory: `t` [s] increasing, shape (N,), and `q` [rad], shape (N, n); smooth, because
                its second derivative is used.
            speed: 1 for as recorded, 0.5 for half of that.

        Raises:
            ControllerError: While moving, in a mode that does not allow it, or when the movement is
                not within the arm's limits.
        """
        try:
            sampled = Sampled(trajectory.t, trajectory.q, speed, self.settings.period)
        except (ValueError, TypeError, AttributeError) as error:
            raise ControllerError(Refusal.REFUSED, f"replay refused: {error}") from None
        limits = self.limits
        if sampled.q.shape[1] != self.arm.n:
            raise ControllerError(
                Refusal.REFUSED,
                f"replay refused: {sampled.q.shape[1]} joints, the arm has {self.arm.n}",
            )
        if np.any(sampled.q < limits.q_min) or np.any(sampled.q > limits.q_max):
            text = "replay refused: the movement leaves the joint limits"
            raise ControllerError(Refusal.REFUSED, text)
        share = float(np.max(np.abs(sampled.qd) / limits.qd_max))
        if share > 1.0:
            raise ControllerError(
                Refusal.TOO_FAST,
                f"replay refused: {share:.2f} times a joint-speed limit",
                {"speed": f"{speed / share:.3f}"},
            )
        self._ask_for_hand(Mode.REPLAY)
        self._move(Mode.REPLAY, sampled.q[0], sampled)
        self.replay_error = FollowingError(self.arm, len(sampled.q))

    def execute(self) -> None:
        """Begin a rollout of the loaded policy with the next state.

        Raises:
            ControllerError: When not ready, with the reason.
        """
        unready = self._unready()
        if unready is not None:
            raise unready
        self._ask_for_hand(Mode.ROLLOUT)
        self._enter(Mode.ROLLOUT)
        self._finished = None
        self.rollout_stamp_ns = None
        self._rollout = Execution(self._policy, self._tables, self.settings)

    def fault(self, fault: Fault) -> None:
        """Latch a fault and abort what is under way; without effect when inactive or in a fault."""
        if self._mode in PASSIVE:
            return
        self.latched = fault
        self.counters["faults"] += 1
        self._enter(Mode.FAULT)

    def reset(self) -> None:
        """Leave a fault and hold.

        Raises:
            ControllerError: Without a fault, while the arm moves, or without valid joint states.
        """
        if self._mode is not Mode.FAULT:
            text = f"reset refused: no fault, mode is {self._mode.value}"
            raise ControllerError(Refusal.REFUSED, text)
        if self._rejected_in_row:
            text = "reset refused: the last joint state was not valid"
            raise ControllerError(Refusal.REFUSED, text)
        self._ask_for_rest("reset")
        self._enter(Mode.HOLD, reset=True)
        self.latched = None

    def deactivate(self) -> None:
        """Abort what is under way; nothing may be sent any more. A fault stays latched."""
        if self._mode not in PASSIVE:
            self._enter(Mode.INACTIVE)

    def _enter(self, mode: Mode, reset: bool = False) -> None:
        """Change the mode, ending what the old one had under way."""
        if self._mode is Mode.FAULT and not reset:
            text = "" if self.latched is None else self.latched.text
            raise ControllerError(
                Refusal.FAULT, f"{mode.value} refused: fault ({text}); reset first"
            )
        if mode not in TRANSITIONS[self._mode]:
            possible = sorted(other.value for other in TRANSITIONS[self._mode])
            raise ControllerError(
                Refusal.BUSY,
                f"{mode.value} is not possible from {self._mode.value}; from there: {possible}",
            )
        if self._q is None and mode is not Mode.INACTIVE:
            text = f"{mode.value} refused: no joint state has come yet"
            raise ControllerError(Refusal.NOTHING, text)
        self._end_rollout()
        if mode not in REFERENCED:
            self._ref = None
        self._set(mode)
        self._course.begin()
        self._exceeded = 0

    def _set(self, mode: Mode) -> None:
        self._mode, self._law, self._mode_label = mode, self._laws[mode], mode.value

    def _lacks_hand(self, mode: Mode) -> bool:
        """Whether the enabling switch must be held in this mode, and is not."""
        if self.enabled or not self.settings.hold_to_run or mode not in HELD:
            return False
        return mode is not Mode.ROLLOUT or self._content not in self._tried

    def _ask_for_hand(self, mode: Mode) -> None:
        if self._lacks_hand(mode):
            text = f"{mode.value} refused: the enabling switch is not held"
            raise ControllerError(Refusal.REFUSED, text)

    def _move(self, mode: Mode, goal: np.ndarray, *then: Sampled) -> None:
        self._ask_for_rest(mode.value)
        self._enter(mode)
        self._course.begin(lambda q: MinJerk(q, goal, self.settings.move_speed), *then)

    def _ask_for_rest(self, request: str) -> None:
        if (unrest := self._unrest()) is not None:
            refusal = Refusal.NOTHING if self._q is None else Refusal.BUSY
            raise ControllerError(refusal, f"{request} refused: {unrest}")

    def _unrest(self) -> str | None:
        if self._q is None:
            return "no joint state has come yet"
        motion = self.arm.motion(self._q, self._qd)
        speed = max(*motion.guarded_speeds, motion.tool_speed, 0.0)
        if speed > self.settings.rest_speed:
            return f"the arm moves at {speed:.3f} m/s, limit {self.settings.rest_speed}"
        spin = float(np.abs(motion.twist[3:]).max())
        if spin > 4.0 * self.settings.rest_speed:
            return f"the tool turns at {spin:.3f} rad/s, limit {4.0 * self.settings.rest_speed}"
        return None

    def _unready(self) -> ControllerError | None:
        """Why a rollout of the loaded policy cannot begin."""

        def refused(refusal: Refusal, text: str, **values: str) -> ControllerError:
            return ControllerError(refusal, f"rollout refused: {text}", values)

        if self.latched is not None:
            return refused(Refusal.FAULT, f"fault ({self.latched.text}); reset first")
        if self._policy is None:
            return refused(Refusal.NOTHING, "no policy is loaded")
        if self._mode is not Mode.HOLD or self._q is None:
            return refused(Refusal.BUSY, f"mode is {self._mode.value}, not hold")
        if (unrest := self._unrest()) is not None:
            return refused(Refusal.BUSY, unrest)
        error = np.abs(self._q - self._policy.q_start)
        worst = int(np.argmax(error))
        if error[worst] > self.settings.start_tolerance:
            text = (
                f"{self.arm.joint_names[worst]} is {error[worst]:.3f} rad from the start of policy"
            )
            policy = self._policy.id
            return refused(Refusal.NOT_AT_START, f"{text} {policy}", policy=policy)
        return None

    # ----------------------------------------------------------------------------- every state

    def step(self, stamp_ns: int, q: np.ndarray, qd: np.ndarray | None) -> np.ndarray:
        """The torque that answers one joint state.

        Finite, within the limits of size and, unless inactive, of change per second. The same
        stamp again gives the same array; a state that is older or not valid is counted and gets
        the last torque, after three in a row the torque that carries the arm.

        Args:
            stamp_ns: From the driver's header [ns].
            q: [rad]. Shape (n,).
            qd: [rad/s], None when the driver does not tell. Shape (n,).

        Returns:
            [N m], read-only. Shape (n,).
        """
        self._steps += 1
        if not isinstance(stamp_ns, _INTEGERS):
            return self._reject("rejected")
        stamp_ns = int(stamp_ns)
        stamp = safety.judge_stamp(stamp_ns, self._stamp, self._period_ns)
        if stamp is Stamp.REPEATED:
            self.counters["repeated"] += 1
            return self._sent
        if stamp is Stamp.OLDER:
            if self._mode not in PASSIVE:
                return self._reject("older")
            stamp = Stamp.FIRST  # the driver has started again
        q = self._read(q, safety.IMPLAUSIBLE_Q)
        if q is None:
            return self._reject("rejected")
        given = self._velocity(stamp, stamp_ns, q) if qd is None else qd
        qd = self._read(given, safety.IMPLAUSIBLE_QD)
        if qd is None:
            return self._reject("rejected")
        return self._answer(stamp, stamp_ns, q, qd)

    def stale_torque(self) -> np.ndarray:
        """The torque to send when no state has come: carries the arm in its last known posture.

        Each call counts as one period for the limit of change. Without any state yet it is zero.

        Returns:
            [N m], read-only. Shape (n,).
        """
        self.counters["stale"] += 1
        if self._q is not None:
            compensated = self.settings.driver_compensates_gravity
            tau = np.zeros(self.arm.n) if compensated else self.arm.gravity(self._q)
            self._sent = safety.limit_torque(tau, self._sent, self.settings.period, self.limits)
            self._sent.setflags(write=False)
        return self._sent

    def _read(self, values: object, bound: float) -> np.ndarray | None:
        """A copy of a joint vector; None when it is not one, not finite or impossibly large."""
        try:
            array = np.array(values, dtype=float)
        except (TypeError, ValueError):
            return None
        if array.shape != (self.arm.n,) or not safety.plausible(array.tolist(), bound):
            return None
        return array

    def _reject(self, why: str) -> np.ndarray:
        self.counters[why] += 1
        self._rejected_in_row += 1
        self._rejections.append(self._steps)
        if len(self._rejections) == 5 and self._steps - self._rejections[0] < 50:
            self.fault(Fault(FaultKind.STATES_REFUSED, "five joint states refused within 50"))
        return self._sent if self._rejected_in_row < 3 else self.stale_torque()

    def _velocity(self, stamp: Stamp, stamp_ns: int, q: np.ndarray) -> np.ndarray:
        """Differentiated and low-passed position; kept as it is across a gap."""
        if stamp is Stamp.FIRST or self._q is None or self._stamp is None:
            return np.zeros(self.arm.n)
        if stamp is Stamp.GAP:
            return self._qd
        dt = (stamp_ns - self._stamp) * 1e-9
        share = 1.0 - math.exp(-self.settings.velocity_cutoff * dt)
        qd = self._qd + share * ((q - self._q) / dt - self._qd)
        qd[np.abs(qd) < 1e-4] = 0.0  # so that the filter comes to rest bit for bit
        return qd

    def _answer(self, stamp: Stamp, stamp_ns: int, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """The torque for a state that has been accepted."""
        counters, limits, period = self.counters, self.limits, self.settings.period
        counters["accepted"] += 1
        self._rejected_in_row = 0
        # Who holds need not know where.
        motion = (self.arm.speeds if self._mode is Mode.HOLD else self.arm.motion)(q, qd)
        dt = period
        if stamp is not Stamp.FIRST and self._stamp is not None and self._q is not None:
            dt = (stamp_ns - self._stamp) * 1e-9
            self._check_continuity(stamp, dt, q)
            dt = min(max(dt, 0.5 * period), 2.0 * period)
        self._stamp, self._q, self._qd = stamp_ns, q, qd
        self._check_motion(q, qd, motion)
        if self.settings.hold_to_run and self._lacks_hand(self._mode):
            self.fault(Fault(FaultKind.RELEASED, "the enabling switch was released"))

        tau = self._torque(stamp_ns, q, qd, motion)
        if self._mode is Mode.INACTIVE:  # nothing is sent, so nothing jumps
            sent = np.minimum(np.maximum(tau, -limits.torque), limits.torque)
        else:
            sent = safety.limit_torque(tau, self._sent, dt, limits)
            if sent is not tau:
                counters["limited"] += 1
        sent.setflags(write=False)
        self._sent = sent
        rollout = self._rollout
        self._label = self._mode_label if rollout is None else f"rollout {rollout.id}"
        return sent

    def _torque(self, stamp_ns: int, q: np.ndarray, qd: np.ndarray, motion: Motion) -> np.ndarray:
        """What the mode wants, before the limits; a fault when that cannot be computed."""
        try:
            tau = self._law(stamp_ns, q, qd, motion)
            wrong = None
            if not math.isfinite(sum(tau.tolist())):
                wrong = Fault(FaultKind.COMPUTATION, "the torque was not finite")
        except TrackingLost as error:
            wrong = Fault(FaultKind.TRACKING, str(error))
        except Exception as error:  # whatever it is, the arm needs a torque in this very tick
            wrong = Fault(FaultKind.COMPUTATION, f"no torque: {error}")
        if wrong is not None:
            self.fault(wrong)
            tau = self._rest_torque(stamp_ns, q, qd, motion)
        springs = safety.limit_springs(q, self.limits)
        if springs is not None:
            tau = tau + springs
        if self.settings.driver_compensates_gravity:
            tau = tau - self.arm.gravity(q)
        return tau

    def _check_continuity(self, stamp: Stamp, dt: float, q: np.ndarray) -> None:
        if stamp is Stamp.GAP:
            self.counters["gaps"] += 1
            if dt > self.settings.stale:
                text = f"no joint state for {dt * 1e3:.0f} ms"
                self.fault(Fault(FaultKind.STATES_LOST, text))
        allowed = self.limits.q_jump * max(1.0, dt / self.settings.period)
        if math.dist(q.tolist(), self._q.tolist()) <= allowed:  # no joint went farther than that
            return
        jump = max(map(abs, (q - self._q).tolist()))
        if jump > allowed:
            self.counters["jumps"] += 1
            if self._mode is not Mode.GRAVITY_COMPENSATION:  # there nothing refers to a posture
                text = f"a joint jumped by {jump:.3f} rad from one state to the next"
                self.fault(Fault(FaultKind.JUMP, text))

    def _check_motion(self, q: np.ndarray, qd: np.ndarray, motion: Motion | Speeds) -> None:
        mode, limits = self._mode, self.limits
        if mode in PASSIVE:
            return
        teaching = mode is Mode.GRAVITY_COMPENSATION
        tool_speed = limits.teaching_tool_speed if teaching else limits.tool_speed
        boxed = mode in BOXED
        guarded = self.arm.guarded
        fault = safety.exceeded(q.tolist(), qd.tolist(), motion, guarded, limits, tool_speed, boxed)
        if fault is None and mode in MOVING:
            points = dict(zip(guarded, motion.guarded_positions, strict=True))
            points["tool"] = motion.position.tolist()
            fault = safety.behind_plane(points, limits)
        self._exceeded = 0 if fault is None else self._exceeded + 1
        if fault is not None and self._exceeded >= limits.periods:
            self.fault(fault)

    # ------------------------------------------------------------------- the torque of each mode

    def _rest_torque(self, _: int, q: np.ndarray, qd: np.ndarray, __: Motion) -> np.ndarray:
        arm, damping = self.arm, self.settings.fault_damping
        return safety.live_fallback(arm.gravity(q), arm.mass_matrix(q), qd, damping)

    def _teaching_torque(self, _: int, q: np.ndarray, qd: np.ndarray, motion: Motion) -> np.ndarray:
        settings, arm = self.settings, self.arm
        damping = safety.teaching_damping(
            motion.tool_speed, settings.teaching_damping, settings.teaching_speed
        )
        return safety.live_fallback(arm.gravity(q), arm.mass_matrix(q), qd, damping)

    def _reference_torque(
        self, stamp_ns: int, q: np.ndarray, qd: np.ndarray, _: Motion
    ) -> np.ndarray:
        """Inverse dynamics of the reference and of a spring-damper: every joint decoupled."""
        last = self._ref or (q, qd)  # continue from the reference, else from where the arm is
        q_ref, qd_ref, qdd_ref = self._course.at(stamp_ns, *last)
        self._ref = q_ref, qd_ref
        if self._course.ended and self._mode is not Mode.HOLD:
            self._set(Mode.HOLD)
        # Plain floats: NumPy costs more than the arithmetic, above all when the caches are cold.
        speed_ref = qd_ref.tolist()
        error = [a - b for a, b in zip(q_ref.tolist(), q.tolist(), strict=True)]
        at_end = not any(speed_ref)  # a brake may lag behind
        worst = max(map(abs, error))
        # An arm that was carried off while it held (idled by its board, say) must not spring back.
        if worst > self.settings.tracking_error and (self._mode is not Mode.HOLD or at_end):
            raise TrackingLost(f"a joint is {worst:.3f} rad away from where it should be")
        if self._mode is Mode.REPLAY and isinstance(self._course.reference, Sampled):
            self.replay_error.add(q_ref, q)
        bandwidth, ratio = self.settings.hold_bandwidth, self.settings.hold_damping_ratio
        stiffness, damping = bandwidth**2, 2.0 * ratio * bandwidth
        rows = zip(qdd_ref.tolist(), error, speed_ref, qd.tolist(), strict=True)
        qdd = np.array([a + stiffness * e + damping * (v - w) for a, e, v, w in rows])
        tau = self.arm.inverse_dynamics(q, qd, qdd)
        if self._mode is not Mode.HOLD:
            # By the reference's direction, not the measured one: it cannot chatter.
            arm, share = self.arm, self.settings.friction_share
            tau += share * (arm.friction * np.tanh(qd_ref / 0.02) + arm.damping * qd_ref)
        return tau

    def _brake(self, q: np.ndarray, qd: np.ndarray) -> Brake:
        limits = self.limits
        return Brake(q, qd, self.settings.brake_time, limits.q_min, limits.q_max)

    def _rollout_torque(
        self, stamp_ns: int, q: np.ndarray, qd: np.ndarray, motion: Motion
    ) -> np.ndarray:
        """Eq. 1 in closed loop on the measured state, and the orientation that belongs to it."""
        rollout = self._rollout
        tick = rollout.tick(stamp_ns)
        self.rollout_stamp_ns = rollout.start_ns
        if tick is None:
            self._tried.add(self._content)
            self._enter(Mode.HOLD)
            return self._reference_torque(stamp_ns, q, qd, motion)
        wanted = rollout.acceleration(tick, motion)
        return self.settings.law.torque(motion, self.arm.dynamics(q, qd), qd, wanted)

    def _end_rollout(self) -> None:
        """Publish the path of a rollout that is over, complete or not."""
        rollout = self._rollout
        if rollout is None:
            return
        if not rollout.count and self._q is not None:  # ended before its first state
            rollout.sample(0, self.arm.motion(self._q, self._qd))
        self._finished = rollout.path()
        self._rollout = None
