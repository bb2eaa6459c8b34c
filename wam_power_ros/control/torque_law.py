# SPDX-License-Identifier: Apache-2.0
"""Torque laws: joint torques for a commanded acceleration of the tool (the paper's Section II-B).

    tau = rnea(q, qd, 0) + J^T F

The wrench F is either Lambda (acc_cmd - Jdot qd), with the tool's apparent inertia Lambda
("operational_space"), or, as in the paper, a virtual mass and a virtual inertia times the
acceleration ("virtual_mass"). Null-space motion is not controlled, so a person can push the elbow
aside.
"""

import numpy as np
from scipy.linalg.lapack import dposv

from wam_power_ros.control.arm import Dynamics, Motion

# Added to J M^-1 J^T: 0.01 1/kg bounds the apparent mass in directions in which the arm cannot
# move, such as with a stretched elbow; without 0.5 1/(kg m^2) the law is unstable at the wrist
# singularity (J6 = 0 of the WAM).
DAMPING = np.diag(np.repeat((0.01, 0.5), 3))  # (6, 6)
VIRTUAL_INERTIA = np.repeat((1.0, 0.01), 3)  # (6,) mass [kg], moment of inertia [kg m^2]


def operational_space(motion: Motion, dynamics: Dynamics, acceleration: np.ndarray) -> np.ndarray:
    """Joint torques (n,) [N m] by the tool's apparent inertia, regularized by `DAMPING`.

    The acceleration (6,) is linear [m/s^2] and angular [rad/s^2], in the base frame.

    Raises:
        numpy.linalg.LinAlgError: The apparent inertia is not positive definite.
    """
    jacobian = dynamics.jacobian
    apparent = jacobian.dot(dynamics.inverse_mass).dot(jacobian.T)
    apparent += DAMPING
    _, wrench, info = dposv(apparent, acceleration - motion.drift)  # Cholesky, unchecked
    if info:
        raise np.linalg.LinAlgError("the arm is singular")
    return dynamics.bias + wrench.dot(jacobian)


def virtual_mass(_: Motion, dynamics: Dynamics, acceleration: np.ndarray) -> np.ndarray:
    """Joint torques [N m] by a virtual mass; arguments as for `operational_space`. Shape (n,)."""
    return dynamics.bias + (VIRTUAL_INERTIA * acceleration).dot(dynamics.jacobian)
