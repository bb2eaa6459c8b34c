# SPDX-License-Identifier: Apache-2.0
"""Eq. 1 integrated open loop for one policy: what an ideal arm would do."""

from collections.abc import Sequence

import numpy as np

from wam_power_ros.learning.dmp import reproduce_many
from wam_power_ros.learning.policy import PERIOD, Policy


def reproduced(
    policy: Policy, x0: np.ndarray, xd0: Sequence[float] = (0.0, 0.0, 0.0), dt: float = PERIOD
) -> tuple[np.ndarray, np.ndarray]:
    """Positions [m] and velocities [m/s] during the movement. Shape (T, 3) each."""
    steps = round(policy.basis.duration / dt) + 1
    arrays = policy.stiffness[np.newaxis], policy.attractors[np.newaxis]
    x, xd = reproduce_many(policy.basis, *arrays, policy.damping, x0, np.array(xd0), steps, dt)
    return x[0], xd[0]
