# SPDX-License-Identifier: Apache-2.0
"""A controller that answers every state with a torque, also when its computation fails.

Whatever raises (a singular matrix, a mistake in the code, no memory), the driver must not be left
alone with the last torque. The exception latches a fault, and the arm is braked and held by numbers
that were computed before: gravity and mass matrix of a posture at most 20 ms earlier. Such a torque
needs no model any more, only the measured state, and that has passed the checks of its form.
"""

from __future__ import annotations

import math

import numpy as np

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.fault_hold import feedback_max
from wam_power_ros.control.joint_control import BANDWIDTH, DAMPING_RATIO
from wam_power_ros.control.modes import ControllerError, Mode, Refusal
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.faults import Fault, FaultKind

REMEMBERED_STATES = 10  # states after which gravity and mass matrix are computed again: 20 ms
STANDSTILL = 0.05  # [rad/s] largest joint speed of an arm at rest, where no tool speed is known


class BrakeWithoutModel:
    """Brakes and holds the arm by the gravity and the mass matrix of an earlier posture.

    tau = g + M (qdd_ref + 2 zeta w (qd_ref - qd)) + s, with the spring s = M w^2 (q_ref - q) that
    is bounded like that of `FaultHold`. The reference begins at
    the state in which the computation failed, and its speed decays at `safety.FAULT_DAMPING`. Near
    the posture M decouples the joints, as in `JointControl`; the spring replaces the change of
    gravity while braking, which alone would let the arm creep away.

    Args:
        arm: Model of the arm; only its limits and its friction are used.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._spring_max = feedback_max(arm)
        self._gravity: np.ndarray | None = None
        self._mass = np.zeros((arm.n, arm.n))
        self._reference: tuple[np.ndarray, np.ndarray] | None = None  # q_ref, qd_ref

    def remember(self, gravity: np.ndarray, mass: np.ndarray) -> None:
        """Keep what brakes and holds the arm near the present posture.

        Args:
            gravity: Torque that carries the arm, as far as the controller has to send it [N m].
                Shape (n,).
            mass: M(q) [kg m^2]. Shape (n, n).
        """
        self._gravity, self._mass = gravity, mass

    def end(self) -> None:
        """Drop the reference: the next failure begins at its own state."""
        self._reference = None

    def torque(self, state: JointState | None, dt: float) -> np.ndarray | None:
        """Torque [N m], shape (n,); None if nothing has been remembered.

        Args:
            state: Measured state; without one gravity alone is carried.
            dt: Time since the last torque [s].
        """
        if self._gravity is None or state is None:
            return self._gravity
        limit = self._arm.qd_max
        q_ref, qd_ref = self._reference or (state.q, np.clip(state.qd, -limit, limit))
        slower = qd_ref * math.exp(-safety.FAULT_DAMPING * dt)
        q_ref = q_ref + (qd_ref - slower) / safety.FAULT_DAMPING
        self._reference = q_ref, slower
        braking = 2.0 * DAMPING_RATIO * BANDWIDTH * (slower - state.qd)
        spring = self._mass.dot(BANDWIDTH**2 * (q_ref - state.q))
        bounded = np.clip(spring, -self._spring_max, self._spring_max)
        return self._gravity + self._mass.dot(braking - safety.FAULT_DAMPING * slower) + bounded


class GuardedController(Controller):
    """Controller whose every exception ends in a fault and in a stop at rest.

    Attributes:
        error: Last exception, until `take_error`; None without one.

    Args:
        arm: Model of the arm, used by this controller alone.
        settings: Settings of the controller.
        latched: Fault that a previous controller had latched; only a reset clears it.

    Raises:
        ValueError: The settings do not match the arm.
    """

    def __init__(
        self,
        arm: Arm,
        settings: ControllerSettings | None = None,
        latched: Fault | None = None,
    ) -> None:
        super().__init__(arm, settings, latched)
        self.error: Exception | None = None
        self._brake = BrakeWithoutModel(arm)
        self._failed = False  # no torque could be computed for the last state
        self._states_since = 0  # the last `remember`

    def take_error(self) -> Exception | None:
        """Return the last exception, once; then None."""
        error, self.error = self.error, None
        return error

    @property
    def at_rest(self) -> bool:
        """Whether the arm was at rest in the last state."""
        try:
            return super().at_rest
        except Exception as error:
            self.error, last = error, self._states.last
            return last is not None and float(np.abs(last.qd).max()) < STANDSTILL

    def step(
        self,
        stamp_ns: int,
        q: np.ndarray,
        qd: np.ndarray | None,
        elapsed: float | None = None,
        since_sent: float | None = None,
    ) -> np.ndarray:
        """See `Controller.step`; it also answers a state for which no torque can be computed."""
        before = self._output.sent
        try:
            tau = super().step(stamp_ns, q, qd, elapsed, since_sent)
            _require_finite(tau)
            if self.fresh:
                self._remember()
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

    def stale_torque(self, elapsed: float | None = None) -> np.ndarray:
        """See `Controller.stale_torque`; gravity of an earlier posture if it cannot be computed."""
        before = self._output.sent
        try:
            tau = super().stale_torque(elapsed)
            _require_finite(tau)
        except Exception as error:
            return self._answer_without_model(error, before, None, elapsed)
        return tau

    def hold(self) -> None:
        """See `Controller.hold`.

        Raises:
            ControllerError: As there, or no torque could be computed for the last state.
        """
        self._require_computed("hold")
        super().hold()

    def stop(self) -> None:
        """See `Controller.stop`; a fault if the motion cannot be ended as usual."""
        try:
            super().stop()
        except ControllerError:
            raise
        except Exception as error:
            self.error = error
            self.fault(_failure(error))

    def fault(self, fault: Fault) -> None:
        """Latch a fault and abort any motion; no effect when inactive or in a fault."""
        try:
            super().fault(fault)
        except Exception as error:  # the path of the rollout is lost
            self.error, self.latched = error, fault
            self._set(Mode.FAULT)

    def reset(self) -> None:
        """See `Controller.reset`.

        Raises:
            ControllerError: As there, or no torque could be computed for the last state.
        """
        self._require_computed("reset")
        super().reset()

    def _require_computed(self, request: str) -> None:
        if self._failed and self.mode in (Mode.INACTIVE, Mode.FAULT):
            text = f"{request} refused: no torque could be computed for the last joint state"
            raise ControllerError(Refusal.REFUSED, text)

    def _remember(self) -> None:
        """Compute anew, once in a while, what brakes the arm without the model."""
        last = self._states.last
        if last is None or self._states_since % REMEMBERED_STATES:
            self._states_since += 1
            return
        mass, gravity = self.arm.mass_matrix(last.q), self.arm.gravity(last.q)
        _require_finite(gravity)
        carried = self.unexplained.compensation
        if not self.settings.driver_compensates_gravity:
            carried = gravity + carried
        self._brake.remember(carried, mass)
        self._states_since = 1

    def _answer_without_model(
        self,
        error: Exception,
        before: np.ndarray,
        state: JointState | None,
        elapsed: float | None,
    ) -> np.ndarray:
        """Latch a fault; returns the torque to send instead [N m], within the limits. Shape (n,).

        Args:
            error: Why no torque could be computed.
            before: Last torque sent [N m]. Shape (n,).
            state: Measured state, if there is one.
            elapsed: Time since the last torque [s]; None for one period.
        """
        self.error, self._failed = error, True
        self.fault(_failure(error))
        self._supervision.begin()  # it does not see what happens meanwhile
        self._supervision.end_estimate()
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


def _failure(error: Exception) -> Fault:
    return Fault(FaultKind.COMPUTATION, f"no torque could be computed: {error!r}")


def _require_finite(tau: np.ndarray) -> None:
    """Raise ArithmeticError unless every torque (n,) [N m] is finite."""
    if not math.isfinite(sum(tau.tolist())):
        raise ArithmeticError(f"torque {tau.tolist()} is not finite")
