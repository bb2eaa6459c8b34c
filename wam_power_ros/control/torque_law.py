# SPDX-License-Identifier: Apache-2.0
"""From a wanted acceleration of the tool to joint torques (the paper's Section II-B).

    tau = rnea(q, qd, 0) + J^T F

The wrench F is either Lambda (acc_cmd - Jdot qd), with the tool's own apparent inertia Lambda
("operational_space"), or the paper's letter: a virtual mass and a virtual inertia times the
acceleration ("virtual_mass"). Joint motion that does not move the tool (the null space) is left
free, so a person may push the elbow aside.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg.lapack import dposv

from wam_power_ros.control.arm import Dynamics, Motion

KINDS = ("operational_space", "virtual_mass")


@dataclass(frozen=True)
class TorqueLaw:
    """Torque law: from a wanted acceleration of the tool to a wrench and joint torques.

    Attributes:
        kind: "operational_space" or "virtual_mass".
        translation_damping: Added to the diagonal of J M^-1 J^T for the translation [1/kg]. Bounds
            the apparent mass where the arm cannot move, at stretched elbow for instance.
        rotation_damping: Added likewise for the rotation [1/(kg m^2)]; without it the law runs
            away at the wrist singularity (J6 = 0 of the WAM).
        mass: Virtual mass m_T [kg], for "virtual_mass".
        inertia: Virtual moment of inertia I_T [kg m^2], for "virtual_mass".
        null_damping: Decay of joint motion that does not move the tool [1/s], for
            "operational_space"; 0 leaves it free.

    Raises:
        ValueError: A value is out of range.
    """

    kind: str = "operational_space"
    translation_damping: float = 0.01
    rotation_damping: float = 0.5
    mass: float = 1.0
    inertia: float = 0.01
    null_damping: float = 0.0
    _damping: np.ndarray = field(init=False, repr=False, compare=False)
    _inertia: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"torque law {self.kind!r} must be one of {KINDS}")
        for name in ("translation_damping", "rotation_damping", "null_damping"):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise ValueError(f"{name} = {value} must be zero or positive")
        for name in ("mass", "inertia"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise ValueError(f"{name} = {value} must be positive")
        damping = np.repeat((self.translation_damping, self.rotation_damping), 3)
        for name, array in (
            ("_damping", np.diag(damping)),
            ("_inertia", np.repeat((self.mass, self.inertia), 3)),
        ):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def torque(
        self, motion: Motion, dynamics: Dynamics, qd: np.ndarray, acceleration: np.ndarray
    ) -> np.ndarray:
        """Joint torques for a wanted acceleration of the tool.

        Args:
            motion: Kinematics of the state.
            dynamics: Dynamics of the same state.
            qd: Joint speeds [rad/s]. Shape (n,).
            acceleration: Linear [m/s^2] and angular [rad/s^2], in the base frame. Shape (6,).

        Returns:
            [N m]. Shape (n,).

        Raises:
            numpy.linalg.LinAlgError: The arm is singular and the law has no damping.
        """
        jacobian = dynamics.jacobian
        if self.kind == "virtual_mass":
            return dynamics.bias + (self._inertia * acceleration).dot(jacobian)
        apparent = jacobian.dot(dynamics.inverse_mass).dot(jacobian.T)
        apparent += self._damping
        wanted = acceleration - motion.drift
        if self.null_damping:
            # M qd is the momentum of all joint motion, J^T Lambda (J qd) that of the tool's.
            wanted += self.null_damping * motion.twist
            wrench = _solved(apparent, wanted)
            free = self.null_damping * _solved(dynamics.inverse_mass, qd)
            return dynamics.bias + wrench.dot(jacobian) - free
        return dynamics.bias + _solved(apparent, wanted).dot(jacobian)


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution of a symmetric positive definite system, by Cholesky: LAPACK without wrapping."""
    _, solution, info = dposv(matrix, right)
    if info:
        raise np.linalg.LinAlgError("the arm is singular")
    return solution
