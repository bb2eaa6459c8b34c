# SPDX-License-Identifier: Apache-2.0
"""Motions the WAM's driver makes by itself: hold a posture, move home (Barrett's services)."""

from __future__ import annotations

import numpy as np

from wam_power_ros.control.arm import Arm

# Position control as libbarrett ships it (config/wam7w.conf), without the integral
KP = np.array([900.0, 2500.0, 600.0, 500.0, 50.0, 50.0, 8.0])  # [N m/rad]
KD = np.array([10.0, 20.0, 5.0, 2.0, 0.5, 0.5, 0.05])  # [N m s/rad]
TAU_MAX = np.array([25.0, 20.0, 15.0, 15.0, 5.0, 5.0, 5.0])  # [N m]
FOLDED = np.array([0.0, -1.95, 0.0, 3.05, 0.0, 0.0, 0.0])  # [rad] Barrett's, just inside the limits
SPEED = 0.5  # [rad/s] of a move home


class Driver:
    """Position control on top of gravity compensation, while engaged."""

    def __init__(self, arm: Arm, adds_gravity: bool, period: float) -> None:
        """`adds_gravity`: g(q) is added below, to whatever is commanded; `period` [s]."""
        self._arm, self._adds_gravity, self._period = arm, adds_gravity, period
        self._goal: np.ndarray | None = None
        self._ref = np.zeros(arm.n)

    @property
    def engaged(self) -> bool:
        """Whether commands are overridden."""
        return self._goal is not None

    @property
    def arrived(self) -> bool:
        """Whether the reference has come to its goal."""
        return self._goal is not None and bool(np.array_equal(self._goal, self._ref))

    def move(self, q: np.ndarray, goal: np.ndarray) -> None:
        """Move from q (nj,) [rad] to a goal (nj,) [rad], all joints at `SPEED`, and hold there."""
        self._ref, self._goal = q.copy(), goal.copy()

    def release(self) -> None:
        """Let commands through again."""
        self._goal = None

    def torque(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """The driver's own command in state q (nj,) [rad], qd (nj,) [rad/s]: (nj,) [N m]."""
        step = SPEED * self._period
        self._ref = self._ref + np.clip(self._goal - self._ref, -step, step)
        tau = np.clip(KP * (self._ref - q) - KD * qd, -TAU_MAX, TAU_MAX)
        return tau if self._adds_gravity else tau + self._arm.gravity(q)
