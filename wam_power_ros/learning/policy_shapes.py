# SPDX-License-Identifier: Apache-2.0
"""Shapes to draw a policy: its planned path and its stiffness ellipsoids."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.policy import Policy, symmetric_part
from wam_power_ros.learning.skill import path

SEMI_AXIS_MAX = 0.06  # longest semi-axis of all ellipsoids of a policy [m]
PLAN_STRIDE = 5  # control periods between two points of a planned path


class Ellipsoids(NamedTuple):
    """Stiffness ellipsoids at the attractors.

    Attributes:
        centres: Attractors mu_i [m]. Shape (n, 3).
        semi_axes: Semi-axes, in proportion to the eigenvalues of K_i [m]. Shape (n, 3).
        quats_wxyz: Orientation of the semi-axes, unit quaternions. Shape (n, 4).
    """

    centres: np.ndarray
    semi_axes: np.ndarray
    quats_wxyz: np.ndarray


def ellipsoids(policy: Policy) -> Ellipsoids:
    """Stiffness ellipsoids of a policy, longest along the stiffest axis."""
    values, axes = np.linalg.eigh(symmetric_part(policy.stiffness))
    axes[..., 0] *= np.linalg.det(axes)[:, None]  # a rotation, not a reflection
    quats = np.roll(rotations.quat_xyzw(axes), 1, axis=-1)
    return Ellipsoids(policy.attractors, SEMI_AXIS_MAX * values / values.max(), quats)


def plan(policy: Policy, start: np.ndarray) -> np.ndarray:
    """Path of Eq. 1, integrated open loop from rest at `start` (3,) [m]. Shape (T, 3)."""
    return path(policy, start)[1][::PLAN_STRIDE]
