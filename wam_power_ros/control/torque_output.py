# SPDX-License-Identifier: Apache-2.0
"""Torque output: clips the torque to the limits of magnitude and rate, and keeps the last one."""

from collections import Counter

import numpy as np

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm


class TorqueOutput:
    """Converts motor torques to torques sent to the driver, within the limits.

    Attributes:
        sent: Last torque sent, read-only [N m]. Shape (n,).

    Args:
        counters: Counter of torques `limited`, updated in place.
    """

    def __init__(
        self,
        arm: Arm,
        limits: safety.Limits,
        driver_compensates_gravity: bool,
        counters: Counter[str],
    ) -> None:
        self.sent = np.zeros(arm.n)
        self._arm, self._limits, self._counters = arm, limits, counters
        self._driver_adds_gravity = driver_compensates_gravity

    def motor_torque(self, q: np.ndarray) -> np.ndarray:
        """Motor torque that results from the last torque sent, at a posture (n,) [rad]. [N m]."""
        tau = self.sent + self._arm.driver_gravity(q) if self._driver_adds_gravity else self.sent
        return tau if self._arm.torque_scales is None else self._arm.torque_scales * tau

    def send(self, tau: np.ndarray, q: np.ndarray, dt: float | None) -> np.ndarray:
        """Return the torque to send for a motor torque, within the limits [N m]. Shape (n,).

        Args:
            tau: Motor torque [N m]. Shape (n,).
            q: Joint positions [rad]. Shape (n,).
            dt: Time since the last torque was sent [s]; None while no torques are sent, so that no
                rate limit applies.
        """
        tau = self._wanted(tau, q)
        if dt is None:
            sent = np.clip(tau, -self._limits.torque, self._limits.torque)
        else:
            sent = safety.limit_torque(tau, self.sent, dt, self._limits)
            if sent is not tau:
                self._counters["limited"] += 1
        sent.setflags(write=False)
        self.sent = sent
        return sent

    def too_heavy(self, q: np.ndarray) -> str:
        """Which joint needs more than its limit to carry the arm at a posture (n,) [rad], or ""."""
        needed, most = np.abs(self._wanted(self._arm.gravity(q), q)), self._limits.torque
        joint = int(np.argmax(needed - most))
        text = f"{self._arm.joint_names[joint]} needs {needed[joint]:.1f} N m to carry the arm"
        return f"{text}, allowed are {most[joint]:.1f}" if needed[joint] > most[joint] else ""

    def _wanted(self, tau: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Torque to send for a motor torque, before the limits."""
        if self._arm.torque_scales is not None:
            tau = tau / self._arm.torque_scales
        if self._driver_adds_gravity:
            # The motors' limits hold for the sum, a share of them for what is sent: a share of the
            # sum would push down an arm that weighs more.
            tau = np.clip(tau, -self._arm.tau_max, self._arm.tau_max) - self._arm.driver_gravity(q)
        return tau
