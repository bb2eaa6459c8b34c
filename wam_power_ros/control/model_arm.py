# SPDX-License-Identifier: Apache-2.0
"""The arm by its rigid-body model, friction included, driven by torques."""

import math
from collections import deque

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.reaction import TORQUE_DELAY
from wam_power_ros.control.state_checks import at_rate

_STEP = 0.001  # [s] of the integration
_FRICTION_SPEED = 0.01  # [rad/s] below it Coulomb friction falls to zero with the speed


class ModelArm:
    """Torques act with the delay of the arm; speeds are reported through a low-pass.

    Attributes:
        q: Joint positions [rad]. Shape (n,).
        qd: Joint speeds [rad/s]. Shape (n,).
        seen: Joint speeds as reported [rad/s]. Shape (n,).

    Args:
        q: Positions to begin with [rad]. Shape (n,).
        tau: Torque sent until then [N m]. Shape (n,).
    """

    def __init__(
        self, arm: Arm, settings: ControllerSettings, q: np.ndarray, tau: np.ndarray
    ) -> None:
        self._arm, period = arm, settings.period
        self._substeps = max(1, round(period / _STEP))
        self._dt = period / self._substeps
        self._delay = at_rate(TORQUE_DELAY, period)
        if settings.loop_delay:
            self._delay = round(settings.loop_delay / period)
        # What the motors of this arm give for the torques that they are sent.
        self._scales = 1.0 if arm.torque_scales is None else arm.torque_scales
        self._low_pass = -math.expm1(-settings.velocity_cutoff * period)
        self.place(q, np.zeros(arm.n), tau)

    def place(self, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> None:
        """Continue at positions [rad] and speeds [rad/s] under a torque [N m]. Shapes (n,)."""
        self.q, self.qd, self.seen = q.copy(), qd, qd
        self._acting = deque([self._scales * tau] * (self._delay + 1), maxlen=self._delay + 1)
        self._change: np.ndarray = np.zeros(len(q))  # of the speeds, expected in a step

    def advance(self, tau: np.ndarray) -> None:
        """Integrate over one period after a torque (n,) [N m] was sent."""
        self._acting.append(self._scales * tau)
        arm, dt = self._arm, self._dt
        for _ in range(self._substeps):
            # Implicit: explicit friction would shake joints of less than 0.0015 kg m^2.
            speed = np.maximum(np.abs(self.qd + self._change), _FRICTION_SPEED)
            resistance = arm.friction / speed + arm.damping
            acting = self._acting[0]
            self._change = dt * arm.resisted_dynamics(self.q, self.qd, acting, resistance, dt)
            self.qd = self.qd + self._change
            self.q = self.q + dt * self.qd
        self.seen = self.seen + self._low_pass * (self.qd - self.seen)
