# SPDX-License-Identifier: Apache-2.0
"""Policies and movements as arrays that a page can draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.dmp import reproduce_many
from wam_power_ros.learning.policy import PERIOD, Policy, symmetric_part

ELLIPSOID = 0.06  # longest semi-axis of all ellipsoids of a policy [m]
PLAN_STEP = 5  # samples of a plan between two that are drawn


class Ellipsoids(NamedTuple):
    """Attractors with their stiffness.

    Attributes:
        centres: Attractors mu_i [m]. Shape (n, 3).
        semi_axes: In proportion to the eigenvalues of K_i [m]. Shape (n, 3).
        quats_wxyz: Orientation of the axes. Shape (n, 4).
    """

    centres: np.ndarray
    semi_axes: np.ndarray
    quats_wxyz: np.ndarray


def ellipsoids(policy: Policy) -> Ellipsoids:
    """Stiffness ellipsoids of a policy: long where it is stiff."""
    values, axes = np.linalg.eigh(symmetric_part(policy.stiffness))
    axes[..., 0] *= np.linalg.det(axes)[:, None]  # a rotation, not a reflection
    quats = np.roll(rotations.quat_xyzw(axes), 1, axis=-1)
    return Ellipsoids(policy.attractors, ELLIPSOID * values / values.max(), quats)


def plan(policy: Policy, start: np.ndarray) -> np.ndarray:
    """Path that Eq. 1 gives from rest at `start` (3,) [m]. Shape (T, 3)."""
    steps = round(policy.basis.duration / PERIOD) + 1
    x, _ = reproduce_many(
        policy.basis,
        policy.stiffness[None],
        policy.attractors[None],
        policy.damping,
        start,
        np.zeros(3),
        steps,
        PERIOD,
    )
    return x[0, ::PLAN_STEP]


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
