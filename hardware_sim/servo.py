# SPDX-License-Identifier: Apache-2.0
"""Servos of an arm that takes no torques: it carries itself and follows set points late."""

from __future__ import annotations

import math

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.inverse_kinematics import posture_near

BANDWIDTH, DAMPING_RATIO = 60.0, 1.0  # [rad/s] of the loop about the smoothed set points
STEPS = 2  # of the inverse kinematics in a period


class Servo:
    """Follows set points through a low-pass with a lag [s], by inverse dynamics.

    `period` [s] is that of its calls.
    """

    def __init__(self, arm: Arm, lag: float, period: float) -> None:
        self._arm, self._period = arm, period
        self._share = 1.0 if lag == 0.0 else -math.expm1(-period / lag)
        self.reset(np.zeros(arm.n))

    def reset(self, q: np.ndarray) -> None:
        """Hold a posture (n,) [rad]."""
        self._q = q.copy()

    def torque(self, goal: np.ndarray, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Torque towards a set point, at positions [rad] and speeds [rad/s]. Shapes (n,)."""
        moved = self._share * (goal - self._q)
        self._q = self._q + moved
        speed = moved / self._period
        error = BANDWIDTH * (self._q - q) + 2.0 * DAMPING_RATIO * (speed - qd)
        arm = self._arm
        return arm.inverse_dynamics(q, qd, BANDWIDTH * error) + arm.friction_torque(speed)


class ToolServo(Servo):
    """The same for poses of the tool, by a posture near its last: where it wanders is its own."""

    def reset(self, q: np.ndarray) -> None:
        """See `Servo`."""
        super().reset(q)
        self._posture = q.copy()

    def torque(self, goal: np.ndarray, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """See `Servo`; the set point is position [m] and quaternion xyzw of the tool (7,)."""
        pose = goal[:3], rotations.matrix(goal[3:])
        self._posture = posture_near(self._arm, self._posture, *pose, STEPS)
        return super().torque(self._posture, q, qd)
