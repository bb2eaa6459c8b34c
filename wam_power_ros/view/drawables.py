# SPDX-License-Identifier: Apache-2.0
"""Movements as arrays for drawing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wam_power_ros.learning.policy import Policy


@dataclass(frozen=True, eq=False)
class Movement:
    """A recorded movement.

    Attributes:
        name: Name of the movement.
        urdf: Text of the arm's URDF.
        joint_names: Names of the joints in the URDF.
        t: Time since the first state [s], strictly increasing. Shape (T,).
        q: Joint angles [rad]. Shape (T, n).
        body: Name of the tracked body, "" for none.
        body_t: Times of the body states [s]. Shape (M,).
        body_position: Positions of the body [m]. Shape (M, 3).
        body_quat_wxyz: Orientations of the body. Shape (M, 4).
        policy: Executed policy, None for a demonstration.
    """

    name: str
    urdf: str
    joint_names: tuple[str, ...]
    t: np.ndarray
    q: np.ndarray
    body: str
    body_t: np.ndarray
    body_position: np.ndarray
    body_quat_wxyz: np.ndarray
    policy: Policy | None

    @property
    def duration(self) -> float:
        """Time from the first state to the last [s]."""
        return float(self.t[-1])

    def joints_at(self, t: float) -> np.ndarray:
        """Interpolated joint angles at time t [s] in rad. Shape (n,)."""
        return np.array([np.interp(t, self.t, column) for column in self.q.T])

    def body_at(self, t: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Position (3,) [m] and quaternion wxyz (4,) in the last body state before time t [s]."""
        index = int(np.searchsorted(self.body_t, t, side="right")) - 1
        return None if index < 0 else (self.body_position[index], self.body_quat_wxyz[index])
