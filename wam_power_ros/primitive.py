# SPDX-License-Identifier: Apache-2.0
"""The movement primitive: a mixture of spring-dampers with full coordination matrices (Eq. 1).

    xdd = sum_i h_i(t) [K_i (mu_i - x) - kappa_V xd]

is affine in x, so A(t) = sum h_i K_i and b(t) = sum h_i K_i mu_i are tabulated once on the
control grid; a step then costs microseconds.
"""

from dataclasses import dataclass

import numpy as np

from wam_power_ros.policy import Basis, Policy

PERIOD = 0.002  # [s] of the control loop


def activations(basis: Basis, t: np.ndarray) -> np.ndarray:
    """Weights h_i(t) of the primitives (Eq. 1); each row sums to one.

    Args:
        basis: Count, duration and variance.
        t: Time since the start [s], clamped to [0, duration]. Shape (T,).

    Returns:
        Shape (T, n).
    """
    t = np.clip(np.asarray(t, dtype=float), 0.0, basis.duration)
    exponent = -0.5 * (t[:, None] - basis.centres) ** 2 / basis.variance  # (T, n)
    # The largest is shifted to exp(0): however narrow the basis, no row underflows to 0/0.
    weights = np.exp(exponent - exponent.max(axis=1, keepdims=True))
    return weights / weights.sum(axis=1, keepdims=True)


def phase(t: np.ndarray, alpha: float) -> np.ndarray:
    """Canonical system sdot = -alpha s, s(0) = 1, solved exactly.

    Args:
        t: [s].
        alpha: Decay [1/s], about 4 / duration.
    """
    return np.exp(-alpha * np.asarray(t, dtype=float))


def time_of_phase(s: np.ndarray, alpha: float) -> np.ndarray:
    """Time at which the canonical system has reached s: t = -ln(s) / alpha.

    Args:
        s: In (0, 1].
        alpha: Decay [1/s].

    Raises:
        ValueError: s is not positive.
    """
    s = np.asarray(s, dtype=float)
    if not np.all(s > 0.0):
        raise ValueError(f"phase {s} must be positive")
    return -np.log(s) / alpha


@dataclass(frozen=True, eq=False)
class Tables:
    """Eq. 1 on the control grid; arrays are read-only, T = round(duration / dt) + 1 rows.

    Attributes:
        a: sum_i h_i K_i [1/s^2]. Shape (T, 3, 3).
        b: sum_i h_i K_i mu_i [m/s^2]. Shape (T, 3).
        rotation_b: rotation_stiffness * sum_i h_i r_i [rad/s^2]. Shape (T, 3).
        damping: kappa_V [1/s].
        rotation_stiffness: [1/s^2].
        rotation_damping: [1/s].
        dt: [s].
    """

    a: np.ndarray
    b: np.ndarray
    rotation_b: np.ndarray
    damping: float
    rotation_stiffness: float
    rotation_damping: float
    dt: float

    @property
    def rows(self) -> int:
        """Number of rows T; the last one is used ever after."""
        return len(self.b)


def tabulate(policy: Policy, dt: float = PERIOD) -> Tables:
    """Tabulate Eq. 1 on the control grid 0, dt, ... duration.

    Args:
        policy: To execute.
        dt: Control period [s].

    Raises:
        ValueError: dt is not positive.
    """
    if not dt > 0.0:
        raise ValueError(f"dt = {dt} must be positive")
    basis = policy.basis
    rows = round(basis.duration / dt) + 1
    h = activations(basis, np.arange(rows) * dt)  # (T, n)
    forces = np.matmul(policy.stiffness, policy.attractors[:, :, None])[:, :, 0]  # (n, 3)
    a = (h @ policy.stiffness.reshape(-1, 9)).reshape(rows, 3, 3)
    b = h @ forces
    rotation_b = policy.rotation_stiffness * (h @ policy.rotation_attractors)
    for array in (a, b, rotation_b):
        array.setflags(write=False)
    return Tables(
        a=a,
        b=b,
        rotation_b=rotation_b,
        damping=policy.damping,
        rotation_stiffness=policy.rotation_stiffness,
        rotation_damping=policy.rotation_damping,
        dt=dt,
    )


def acceleration(tables: Tables, k: int, x: np.ndarray, xd: np.ndarray) -> np.ndarray:
    """Wanted acceleration of Eq. 1 at tick k.

    Args:
        tables: From `tabulate`.
        k: Tick since the start, not negative; beyond the last row the last row holds.
        x: Position [m]. Shape (3,).
        xd: Velocity [m/s]. Shape (3,).

    Returns:
        [m/s^2]. Shape (3,).
    """
    b = tables.b
    if k >= len(b):
        k = -1
    return b[k] - tables.a[k].dot(x) - tables.damping * xd


def angular_acceleration(
    tables: Tables, k: int, rotation: np.ndarray, omega: np.ndarray
) -> np.ndarray:
    """Wanted angular acceleration at tick k, the same law on the rotation vector.

    Args:
        tables: From `tabulate`.
        k: Tick since the start, not negative; beyond the last row the last row holds.
        rotation: r of R = exp(r) R_ref, in the base frame [rad]. Shape (3,).
        omega: Angular velocity in the base frame [rad/s]. Shape (3,).

    Returns:
        [rad/s^2]. Shape (3,).
    """
    b = tables.rotation_b
    if k >= len(b):
        k = -1
    return b[k] - tables.rotation_stiffness * rotation - tables.rotation_damping * omega
