# SPDX-License-Identifier: Apache-2.0
"""Movements as arrays that a page can draw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wam_power_ros.learning.policy import Policy


@dataclass(frozen=True, eq=False)
class Movement:
    """A recorded movement.

    Attributes:
        name: Name of it.
        urdf: Text of the arm's URDF.
        joint_names: Joints in the URDF.
        t: Time since its first state [s], strictly increasing. Shape (T,).
        q: Joint angles [rad]. Shape (T, n).
        body: Name of the tracked body, empty for none.
        body_t: Times of its states [s]. Shape (M,).
        body_position: Positions [m]. Shape (M, 3).
        body_quat_wxyz: Orientations. Shape (M, 4).
        policy: Policy that was executed, None for a demonstration.
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
        """Time from its first state to its last [s]."""
        return float(self.t[-1])

    def joints_at(self, t: float) -> np.ndarray:
        """Joint angles at a time [rad], interpolated. Shape (n,)."""
        return np.array([np.interp(t, self.t, column) for column in self.q.T])

    def body_at(self, t: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Newest position (3,) [m] and quaternion wxyz (4,) of the body at a time."""
        seen = int(np.searchsorted(self.body_t, t, side="right")) - 1
        return None if seen < 0 else (self.body_position[seen], self.body_quat_wxyz[seen])


def segments(points: np.ndarray) -> np.ndarray:
    """Line segments (T - 1, 2, 3) of a path (T, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1)
