# SPDX-License-Identifier: Apache-2.0
"""Reference output: the controller of an arm that takes positions or poses instead of torques.

The torques of `Controller` drive the rigid-body model of the arm, and the positions of the model
are sent. So policies, modes, limits and requests are the same, and all of it is checked on the
motion that is about to be sent. The reported states are checked, too: their values, stamps, speeds
and limits, and that they follow what was sent, with any delay up to `FOLLOW_TIME`. What a torque
would tell, such as a contact or a payload, cannot be checked.

In a fault the references come to rest within `STOP_TIME` and stay there. While a person guides the
arm, in the free drive of its maker, they stay behind it by `SLACK` at most. No reference is further
from the one before than the speed limits allow in one period.

With poses the driver alone decides on the posture, and a redundant arm wanders off from the model.
So the tool is what must follow and be at the start; joints are checked as reported.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm, Motion
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.inverse_kinematics import posture_near
from wam_power_ros.control.joint_references import Brake
from wam_power_ros.control.model_arm import ModelArm
from wam_power_ros.control.modes import PASSIVE_MODES, ControllerError, Mode, Refusal
from wam_power_ros.control.plausibility import Bound, Plausibility
from wam_power_ros.control.state_checks import STATE_LOSS_TIMEOUT, JointState, StateChecks
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.dmp import TabulatedPolicy

STOP_TIME = 0.25  # [s] in which references come to rest in a fault: 7.5 speed limits per second
FOLLOW_TIME = 0.3  # [s] within which the arm must follow: delay and three time constants of a servo
FOLLOW_ERROR = 0.1  # [rad], or [m] of a slide or a tool, from all references of that time
SLACK = 0.003  # [rad] more than a servo sags, so that an arm in no free drive does not sink
_STEPS, _SAME = 30, 1e-6  # of the inverse kinematics, and its largest error in m and rad
_FOLLOWING = (*PASSIVE_MODES, Mode.GRAVITY_COMPENSATION)  # the model is where the arm is


def controller_of(
    arm: Arm, settings: ControllerSettings, latched: Fault | None = None
) -> Controller:
    """Controller of an arm for the output of its settings; arguments as of `Controller`."""
    kind: type[Controller] = ReferenceController if settings.set_point_period else Controller
    return (PoseController if settings.poses else kind)(arm, settings, latched)


class ReferenceController(Controller):
    """Computes positions from joint states; used like a `Controller`, whose torques they replace.

    Before the first state the positions are NaN. The settings have a `set_point_period`.
    """

    _away = "joint {0} is {1:.3f} rad"

    def __init__(
        self, arm: Arm, settings: ControllerSettings, latched: Fault | None = None
    ) -> None:
        super().__init__(arm, settings, latched)
        n, period = arm.n, settings.state_period or settings.period
        self._measured = StateChecks(n, period, settings.velocity_cutoff, arm.qd_max)
        self._measured.counters, self._states.counters = self.counters, Counter()
        self._plausibility = Plausibility(arm, period)
        self._unbounded = Bound(np.full(n, np.inf), np.full(n, np.inf))
        self._limit_check = safety.MotionCheck(self.limits, arm.guarded, period)
        self._motion: Motion | None = None  # of the last state
        self._model = ModelArm(arm, self.settings, np.zeros(n), np.zeros(n))
        self._followed = True  # the model was where the arm is in the last state
        self._period_ns = round(settings.period * 1e9)
        self._wait_ns = round(settings.set_point_period * 1e9 - 0.5e9 * period)  # states jitter
        self._model_ns = self._now_ns = self._sent_ns = 0  # of the model, now, the last set point
        self._reference = np.full(n, np.nan)  # last set point [rad]
        self._speed = np.zeros(n)  # with which it moves [rad/s]
        self._step = self.limits.qd_max * settings.set_point_period  # of a set point, at most
        self._offset = np.zeros(n)  # reference minus model, which dwindles [rad]
        self._silent = True  # nothing has been sent since the last mode in which the arm is held
        self._stopping: Brake | None = None  # in a fault
        self._stopped = 0.0  # time since its beginning [s]
        rows, width = max(2, round(FOLLOW_TIME / settings.period)), len(self._place(arm.q_min))
        self._recent = np.empty((rows, width))  # places of the model
        self._count = 0  # of these since the model began to move by itself

    # Status and requests

    @property
    def stamp_ns(self) -> int | None:
        """See `Controller`."""
        return None if self._measured.last is None else self._measured.last.stamp_ns

    @property
    def refusal(self) -> str:
        """See `Controller`."""
        return self._measured.refusal

    @property
    def _reported(self) -> JointState | None:
        return self._measured.last

    def _rest_violation(self) -> str:
        model = super()._rest_violation()
        return model or ("" if self._motion is None else safety.rest_violation(self._motion))

    def execute(self) -> None:
        """See `Controller`; the path is that of the reported states."""
        super().execute()
        if self._rollout is not None:
            self._rollout.of_model = True

    def release(self) -> None:
        """Keep the last reference: the driver holds the arm by it."""

    def deactivate(self) -> None:
        """See `Controller`; in a fault the references then stay near the arm, whoever moves it."""
        super().deactivate()
        self._silent = True

    def reset(self) -> None:
        """See `Controller`."""
        if self._measured.refused_in_row:
            text = "reset refused: the last joint state was not valid"
            raise ControllerError(Refusal.REFUSED, text)
        super().reset()

    # Control cycle

    def step(
        self,
        stamp_ns: int,
        q: np.ndarray,
        qd: np.ndarray | None,
        elapsed: float | None = None,
        since_sent: float | None = None,
    ) -> np.ndarray:
        """Compute the reference for one joint state; arguments as of `Controller.step`.

        Returns:
            [rad], read-only; the same array again until the next set point is due. Shape (n,).
        """
        state = self._measured.take(stamp_ns, q, qd, self._mode in PASSIVE_MODES, elapsed)
        if self._measured.fault is not None:
            self.fault(self._measured.fault)
        self.fresh = state is not None
        if state is None:
            return self._reference
        self._now_ns = state.stamp_ns
        try:
            self._check(state)
            if self._mode in _FOLLOWING:
                self._follow(state)
            else:
                self._drive()
                if self._rollout is not None and self._motion is not None:
                    self._rollout.record(state.stamp_ns, self._motion)
        except Exception as error:  # the references need no model to come to rest
            self._fault_of(error)
        self.fresh = True
        return self._set_point(state.q)

    def refuse_state(self) -> None:
        """See `Controller`."""
        self._measured.refuse()
        if self._measured.fault is not None:
            self.fault(self._measured.fault)

    def stale_torque(self, elapsed: float | None = None) -> np.ndarray:
        """Reference to send while states are missing: the movement goes on until that is a fault.

        Arguments and result are as of `Controller.stale_torque`, the result in [rad].
        """
        self.counters["stale"] += 1
        if (last := self._measured.last) is None:
            return self._reference
        dt = self.settings.period if elapsed is None else min(elapsed, STATE_LOSS_TIMEOUT)
        self._now_ns += round(dt * 1e9)
        try:
            self._drive()
        except Exception as error:
            self._fault_of(error)
        return self._set_point(last.q)

    def _check(self, state: JointState) -> None:
        """Latch the fault of a reported state, if it has one."""
        self._motion = self.arm.motion(state.q, state.qd)
        carried = self.arm.gravity(state.q)
        fault = self._plausibility.fault(self._measured.before, state, carried, self._unbounded)
        fault = fault or self._limit_check.fault(self._mode, state, self._motion)
        if (fault := fault or self._lost(state.q)) is not None:
            self.fault(fault)

    def _lost(self, q: np.ndarray) -> Fault | None:
        """Fault of an arm at a posture (n,) [rad] that is far from every recent reference."""
        if self._mode in _FOLLOWING or not self._count:
            return None
        low, high = self._recent.min(axis=0), self._recent.max(axis=0)
        place = self._place(q)
        error = np.maximum(low - place, place - high)
        if error[worst := int(error.argmax())] <= FOLLOW_ERROR:
            return None
        text = f"{self._away.format(worst + 1, error[worst])} from all its references of the last "
        return Fault(FaultKind.TRACKING, f"{text}{FOLLOW_TIME} s, limit {FOLLOW_ERROR}")

    def _place(self, q: np.ndarray) -> np.ndarray:
        """What has to follow, at a posture (n,) [rad]."""
        return q

    def _follow(self, state: JointState) -> None:
        """Put the model where the arm is, carried by its own controller."""
        if not self._followed:
            self._states.last = None  # it was of the model
        self._followed = True
        self._output.sent = carried = self.arm.gravity(state.q)
        super().step(state.stamp_ns, state.q, state.qd)
        self._output.sent = carried
        still = np.zeros(self.arm.n)
        if self._mode is not Mode.FAULT:
            self._speed = still
        guided = self._mode is Mode.GRAVITY_COMPENSATION
        self._model.place(state.q, state.qd if guided else still, carried)
        self._model_ns = state.stamp_ns + self._period_ns
        self._count = 0

    def _drive(self) -> None:
        """Let the torques of the mode drive the model up to now."""
        model = self._model
        while self._mode not in _FOLLOWING and self._late() < 0.5:
            self._followed = False
            model.advance(super().step(self._model_ns, model.q, model.seen))
            self._model_ns += self._period_ns
            if not math.isfinite(sum(model.q.tolist())):
                raise ArithmeticError(f"the model is at {model.q.tolist()}")
            self._speed = model.qd
            row = self._count % len(self._recent) if self._count else ...
            self._recent[row] = self._place(model.q)
            self._count += 1

    def _late(self) -> float:
        """Time of the model after now, in periods."""
        return (self._model_ns - self._now_ns) / self._period_ns

    def _set_point(self, q: np.ndarray) -> np.ndarray:
        """Next reference (n,) [rad] if it is due, else the last; the arm reported q (n,) [rad]."""
        settings, last, mode = self.settings, self._reference, self._mode
        if mode is not Mode.INACTIVE and 0 <= self._now_ns - self._sent_ns < self._wait_ns:
            return last
        if mode is not Mode.FAULT:
            self._stopping, self._stopped, self._silent = None, 0.0, mode is Mode.INACTIVE
        if mode is Mode.INACTIVE or not self._sent_ns:  # nothing is sent, or has been
            last = q
        self._sent_ns = self._now_ns
        if mode is Mode.FAULT and not self._silent:
            limits = self.limits
            speed = np.clip(self._speed, -limits.qd_max, limits.qd_max)
            begun = self._stopping or Brake(last, speed, STOP_TIME, limits.q_min, limits.q_max)
            self._stopping, self._stopped = begun, self._stopped + settings.set_point_period
            wanted = begun.at(self._stopped)[0]
        elif mode in _FOLLOWING:
            wanted = np.clip(last, q - SLACK, q + SLACK)
        else:
            back = settings.move_speed * settings.set_point_period
            self._offset = self._offset - np.clip(self._offset, -back, back)
            ahead = float(np.clip(1.0 - self._late(), -0.5, 0.5)) * settings.period
            wanted = self._model.q + ahead * self._model.qd + self._offset
        reference = last + np.clip(wanted - last, -self._step, self._step)
        if mode in _FOLLOWING:
            self._offset = reference - q
        reference.setflags(write=False)
        self._reference = reference
        return reference


class PoseController(ReferenceController):
    """Computes poses of the tool in the base frame: position [m], quaternion xyzw. Shape (7,)."""

    _away = "the tool is {1:.3f} m or rad"
    _posed: np.ndarray | None = None  # the reference whose pose was sent last
    _pose = np.full(7, np.nan)

    def step(
        self,
        stamp_ns: int,
        q: np.ndarray,
        qd: np.ndarray | None,
        elapsed: float | None = None,
        since_sent: float | None = None,
    ) -> np.ndarray:
        """See `ReferenceController`."""
        return self._pose_of(super().step(stamp_ns, q, qd, elapsed, since_sent))

    def stale_torque(self, elapsed: float | None = None) -> np.ndarray:
        """See `ReferenceController`."""
        return self._pose_of(super().stale_torque(elapsed))

    def set_gravity_compensation(self, on: bool) -> None:
        """See `Controller`."""
        super().set_gravity_compensation(on)
        self._take_posture()

    def reset(self) -> None:
        """See `Controller`."""
        super().reset()
        self._take_posture()

    def _pose_of(self, reference: np.ndarray) -> np.ndarray:
        """Pose (7,) of a reference (n,) [rad]; the same array for the same one."""
        if reference is not self._posed:
            try:
                position, rotation = self.arm.tool_pose(reference)
                quat_xyzw = rotations.quat_xyzw(rotation)
                if quat_xyzw @ self._pose[3:] < 0.0:  # both are the same, but the step is smaller
                    quat_xyzw = -quat_xyzw
                self._pose = np.concatenate([position, quat_xyzw])
                self._pose.setflags(write=False)
                self._posed = reference
            except Exception as error:  # the last pose stays
                self._fault_of(error)
        return self._pose

    def _take_posture(self) -> None:
        """Give the last reference the arm's posture and keep its pose, or the tool would move."""
        last, (position, rotation) = self._measured.last, self.arm.tool_pose(self._reference)
        if last is None:
            return
        found = posture_near(self.arm, last.q, position, rotation, _STEPS)
        if np.abs(self._place(found) - self._place(self._reference)).max() < _SAME:
            found.setflags(write=False)
            self._reference, self._offset = found, found - last.q

    @property
    def _reported(self) -> JointState | None:
        return self._states.last  # of the model: the posture is the driver's

    def _require_ready(self) -> TabulatedPolicy:
        policy, last = super()._require_ready(), self._measured.last
        away = 0.0 if last is None else self._place(last.q) - self._place(policy.q_start)
        if (error := float(np.abs(away).max())) > self.settings.start_tolerance:
            text = f"{self._away.format(0, error)} from the start of policy {policy.id}"
            raise ControllerError(Refusal.NOT_AT_START, f"rollout refused: {text}")
        return policy

    def _place(self, q: np.ndarray) -> np.ndarray:
        position, rotation = self.arm.tool_pose(q)
        return np.concatenate([position, rotation.ravel()])  # a small turn is as much in its axes
