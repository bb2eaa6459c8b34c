# SPDX-License-Identifier: Apache-2.0
"""Brake and hold of an arm whose model raises, by what it gave at most 20 ms before."""

from __future__ import annotations

import math

import numpy as np

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.joint_control import BANDWIDTH, DAMPING_RATIO
from wam_power_ros.control.state_checks import JointState, at_rate
from wam_power_ros.learning.policy import PERIOD

FRICTION_FACTOR = 2.0  # multiple of a joint's friction in the bound of the feedback
TORQUE_SHARE = 0.05  # share of a joint's torque limit added to it: payload, tilt, weak motors
REMEMBERED_STATES = 10  # states, at 500 Hz, after which gravity and mass matrix are computed again


def feedback_max(arm: Arm) -> np.ndarray:
    """Bound on the feedback that holds a stopped arm [N m]. Shape (n,)."""
    return FRICTION_FACTOR * arm.friction + TORQUE_SHARE * arm.tau_max


class BrakeWithoutModel:
    """Brakes and holds the arm by gravity and mass matrix of a posture at most 20 ms earlier.

    tau = g + M (qdd_ref + 2 zeta w (qd_ref - qd)) + s, with the bounded spring s = M w^2 (q_ref -
    q). It needs no model any more, only a measured state. The reference begins at the state in
    which the computation failed, and its speed decays at `safety.FAULT_DAMPING`. Near the posture M
    decouples the joints, as in `JointControl`; the spring replaces the change of gravity while
    braking, which alone would let the arm creep away.
    """

    def __init__(self, arm: Arm, driver_compensates_gravity: bool, period: float = PERIOD) -> None:
        self._remembered = at_rate(REMEMBERED_STATES, period)
        self._driver_adds_gravity = driver_compensates_gravity
        self._qd_max, self._spring_max = arm.qd_max, feedback_max(arm)
        self._scales = arm.torque_scales
        self._gravity: np.ndarray | None = None  # beyond what the driver adds [N m]
        self._added = np.zeros(arm.n)  # by the driver [N m]
        self._mass = np.zeros((arm.n, arm.n))
        self._states = 0  # states observed since they were computed
        self._reference: tuple[np.ndarray, np.ndarray] | None = None  # q_ref, qd_ref

    def observe(self, arm: Arm, q: np.ndarray, model_error: np.ndarray) -> None:
        """Compute anew, every 20 ms, what carries and brakes the arm.

        Args:
            q: Joint positions [rad]. Shape (n,).
            beyond: Torque that carries the arm beyond g(q) [N m]. Shape (n,).

        Raises:
            ArithmeticError: The model gives no finite gravity; what was kept remains.
        """
        if self._states % self._remembered == 0:
            mass, gravity = arm.mass_matrix(q), arm.gravity(q)
            if not math.isfinite(sum(gravity.tolist())):
                raise ArithmeticError(f"gravity {gravity.tolist()} is not finite")
            if self._driver_adds_gravity:
                self._added = arm.driver_gravity(q)
            self._gravity = gravity - self._added + model_error
            self._mass, self._states = mass, 0
        self._states += 1

    def end(self) -> None:
        """Drop the reference: the next failure begins at its own state."""
        self._reference = None

    def torque(self, state: JointState | None, dt: float) -> np.ndarray | None:
        """Torque to send [N m], shape (n,), `dt` [s] after the last; None if no state was observed.

        Without a measured state gravity alone is carried.
        """
        if self._gravity is None:
            return None
        tau = self._gravity if state is None else self._braked(self._gravity, state, dt)
        return tau if self._scales is None else (tau + self._added) / self._scales - self._added

    def _braked(self, carrying: np.ndarray, state: JointState, dt: float) -> np.ndarray:
        """Torque that carries, brakes and holds the arm [N m]. Shape (n,)."""
        limit = self._qd_max
        q_ref, qd_ref = self._reference or (state.q, np.clip(state.qd, -limit, limit))
        slower = qd_ref * math.exp(-safety.FAULT_DAMPING * dt)
        q_ref = q_ref + (qd_ref - slower) / safety.FAULT_DAMPING
        self._reference = q_ref, slower
        braking = 2.0 * DAMPING_RATIO * BANDWIDTH * (slower - state.qd)
        spring = self._mass.dot(BANDWIDTH**2 * (q_ref - state.q))
        bounded = np.clip(spring, -self._spring_max, self._spring_max)
        return carrying + self._mass.dot(braking - safety.FAULT_DAMPING * slower) + bounded
