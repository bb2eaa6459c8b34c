# SPDX-License-Identifier: Apache-2.0
"""The torque that is sent: within the limits of size and of change, and remembered."""

from collections import Counter

import numpy as np

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm


class TorqueOutput:
    """What a driver is sent for the torque that the motors are to give.

    Attributes:
        sent: Last torque that was sent, read-only [N m]. Shape (n,).

    Args:
        arm: Model of the arm.
        limits: Limits of the arm.
        driver_compensates_gravity: The driver adds g(q) itself; it is left out of what is sent.
        counters: Counts torques `limited`.
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
        self._compensated = driver_compensates_gravity

    def acting(self, q: np.ndarray) -> np.ndarray:
        """Torque that the motors give at a posture (n,) [rad]: the last one that was sent [N m]."""
        return self.sent + self._arm.gravity(q) if self._compensated else self.sent

    def send(self, tau: np.ndarray, q: np.ndarray, dt: float | None) -> np.ndarray:
        """What is sent for a torque of the motors, within the limits of size and of change [N m].

        Args:
            tau: Torque of the motors [N m]. Shape (n,).
            q: Joint positions [rad]. Shape (n,).
            dt: Time since the last one was sent, None while nothing is: then nothing jumps [s].
        """
        if self._compensated:  # what the motors give is limited
            tau = self._bounded(tau) - self._arm.gravity(q)
        if dt is None:
            sent = self._bounded(tau)
        else:
            sent = safety.limit_torque(tau, self.sent, dt, self._limits)
            if sent is not tau:
                self._counters["limited"] += 1
        sent.setflags(write=False)
        self.sent = sent
        return sent

    def _bounded(self, tau: np.ndarray) -> np.ndarray:
        return np.minimum(np.maximum(tau, -self._limits.torque), self._limits.torque)
