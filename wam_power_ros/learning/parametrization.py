# SPDX-License-Identifier: Apache-2.0
"""Parametrization of a policy: its learnt parameters and their exploration noise.

Stiffness is several hundred 1/s^2 and attractors are tenths of a metre, so "the sigma_i are
different" ([Kormushev2010], footnote 3). Hence theta = theta0 + scale * z with one scale per group,
and every learner explores z with unit standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from wam_power_ros.learning.dmp import positive_definite
from wam_power_ros.learning.policy import Policy, at_tempo, read_only, symmetric_part

# Smallest eigenvalue of a sampled K_i, as a fraction of the smallest one of the demonstration [1]
EIGENVALUE_FLOOR = 0.1
_XZ = np.ix_((0, 2), (0, 2))


class NoiseScales(BaseModel):
    """Standard deviation of the exploration noise of each group of parameters.

    Attributes:
        stiffness: Noise of every entry of K_i, as a fraction of the policy's mean stiffness [1].
        attractor: Noise of every entry of mu_i [m].
        rotation: Noise of every entry of r_i [rad].
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    stiffness: float = Field(gt=0.0, le=1.0)
    attractor: float = Field(gt=0.0, le=1.0)
    rotation: float = Field(gt=0.0, le=1.0)


@dataclass(frozen=True, eq=False)
class Direction:
    """One parameter that moves all attractors together along a fixed pattern.

    Attributes:
        name: Name of its group.
        scale: Standard deviation of the exploration noise, in units of the parameter.
        attractors: Displacement of every mu_i for a parameter of one [m]. Shape (n, 3).
        rotation: Displacement of every r_i for a parameter of one [rad]. Shape (n, 3).

    Raises:
        ValueError: If the scale is not positive, or a pattern is not finite or of another shape.
    """

    name: str
    scale: float
    attractors: np.ndarray
    rotation: np.ndarray

    def __post_init__(self) -> None:
        if not 0.0 < self.scale < np.inf:
            raise ValueError(f"{self.name}: scale = {self.scale} must be positive")
        shape = (len(self.attractors), 3)
        for field in ("attractors", "rotation"):
            pattern = read_only(f"{self.name}: {field}", getattr(self, field), shape)
            object.__setattr__(self, field, pattern)


@dataclass(frozen=True)
class _Layout:
    """Learnt entries of each K_i, mu_i and r_i."""

    entries: tuple[tuple[int, int], ...]  # learnt entries of K_i
    symmetric: bool  # entry (column, row) of K_i changes together with (row, column)
    axes: tuple[int, ...]  # learnt elements of mu_i
    rotation_axes: tuple[int, ...] = ()  # learnt elements of r_i


_DIAGONAL = ((0, 0), (1, 1), (2, 2))
_LAYOUTS = {
    "full": _Layout(tuple((i, j) for i in range(3) for j in range(3)), False, (0, 1, 2)),
    "diagonal": _Layout(_DIAGONAL, False, (0, 1, 2)),
    "symmetric": _Layout((*_DIAGONAL, (0, 1), (0, 2), (1, 2)), True, (0, 1, 2)),
    "attractors": _Layout((), False, (0, 1, 2)),
    "planar": _Layout(((0, 0), (2, 2), (0, 2)), True, (0, 2), (1,)),
}
VARIANTS = tuple(_LAYOUTS)


class Parametrization:
    """Map from coordinates z to policies around one demonstrated policy.

    Variants, for a mixture of n spring-dampers:
        full: K_i and mu_i, 9 n + 3 n parameters (the paper's).
        diagonal: The diagonal of K_i, and mu_i, 3 n + 3 n; off-diagonal entries are zero.
        symmetric: The symmetric part of K_i, and mu_i, 6 n + 3 n.
        attractors: mu_i, 3 n.
        planar: A movement in the x-z plane: K_xx, K_zz and K_xz, mu_x and mu_z, and the rotation
            attractor about y (pitch), 6 n.
    Each direction adds one parameter, and so does the logarithm of the tempo, see `at_tempo`.
    Everything else is as in `policy0`.

    Attributes:
        size: Number of parameters.
        variant: Name of the variant.
        policy0: Policy at z = 0.
        theta0: Parameters of `policy0` [1/s^2, m, rad, units of the directions]. Shape (size,).
        scale: Standard deviation of the exploration noise, in the units of theta. Shape (size,).
        groups: Slice of each group in theta and z: "stiffness", "attractors", "rotation", and the
            directions by name, "tempo"; groups without parameters are left out.
        stiffness_min: Smallest eigenvalue of the symmetric part of a sampled K_i [1/s^2].
    """

    def __init__(
        self,
        policy0: Policy,
        variant: str,
        noise: NoiseScales,
        directions: Sequence[Direction] = (),
        tempo: float = 0.0,
    ) -> None:
        """Combine the parameters of `variant` with the directions and the tempo.

        Args:
            policy0: Policy at z = 0.
            variant: Name of the variant.
            noise: Standard deviation of the exploration noise of the variant's parameters.
            directions: Additional parameters that move all attractors together.
            tempo: Standard deviation of the exploration noise of the logarithm of the tempo; 0: the
                tempo is not learnt.

        Raises:
            ValueError: If the variant is unknown, a pattern is not one of n spring-dampers, or the
                name of a direction is already in use.
        """
        if variant not in _LAYOUTS:
            raise ValueError(f"variant {variant!r} is not one of {', '.join(VARIANTS)}")
        layout = _LAYOUTS[variant]
        n = policy0.basis.count
        for direction in directions:
            if len(direction.attractors) != n:
                raise ValueError(
                    f"direction {direction.name!r} has {len(direction.attractors)} attractors, "
                    f"policy {policy0.id!r} has {n}"
                )
        if variant == "diagonal":
            policy0 = replace(policy0, stiffness=policy0.stiffness * np.eye(3))
        symmetric = symmetric_part(policy0.stiffness)  # (n, 3, 3)
        mean_stiffness = float(np.trace(symmetric, axis1=1, axis2=2).mean() / 3.0)
        self.variant = variant
        self.policy0 = policy0
        self.stiffness_min = EIGENVALUE_FLOOR * float(np.linalg.eigvalsh(symmetric).min())
        self._layout = layout
        self._directions = tuple(directions)
        self._n = n

        blocks: list[tuple[str, np.ndarray, float]] = []
        if layout.entries:
            value = self._entries(policy0.stiffness)
            blocks.append(("stiffness", value, noise.stiffness * mean_stiffness))
        value = policy0.attractors[:, layout.axes].ravel()
        blocks.append(("attractors", value, noise.attractor))
        if layout.rotation_axes:
            value = policy0.rotation_attractors[:, layout.rotation_axes].ravel()
            blocks.append(("rotation", value, noise.rotation))
        for direction in directions:
            blocks.append((direction.name, np.zeros(1), direction.scale))
        if tempo:
            blocks.append(("tempo", np.zeros(1), tempo))

        self.theta0 = np.concatenate([value for _, value, _ in blocks])
        self.scale = np.concatenate([np.full(len(value), scale) for _, value, scale in blocks])
        self.size = len(self.theta0)
        self.groups: dict[str, slice] = {}
        start = 0
        for group, value, _ in blocks:
            if group in self.groups:
                raise ValueError(f"name {group!r} of a direction is already used by another group")
            self.groups[group] = slice(start, start + len(value))
            start += len(value)
        self.theta0.setflags(write=False)
        self.scale.setflags(write=False)

    def theta(self, z: np.ndarray) -> np.ndarray:
        """Parameters in their own units, theta0 + scale * z. Shape (size,)."""
        return self.theta0 + self.scale * self._checked(z)

    def policy(self, z: np.ndarray, policy_id: str) -> tuple[Policy, np.ndarray]:
        """Policy at z, with every stiffness matrix positive definite.

        Args:
            z: Requested coordinates. Shape (size,).
            policy_id: Id of the new policy.

        Returns:
            The policy and its coordinates, `clip(z)`, which are the ones to learn from.
            `policy(clip(z), policy_id)` is the same policy, bit for bit.
        """
        z = self.clip(z)
        delta = self.scale * z
        attractors, rotation = self._attractors(delta)
        policy = replace(
            self.policy0,
            id=policy_id,
            stiffness=self._stiffness(delta),
            attractors=attractors,
            rotation_attractors=rotation,
        )
        return (at_tempo(policy, float(self.tempo(z))) if "tempo" in self.groups else policy), z

    def tempo(self, z: np.ndarray) -> np.ndarray:
        """Tempo at z (..., size), relative to that of `policy0` [1]. Shape (...)."""
        if "tempo" not in self.groups:
            return np.ones(z.shape[:-1])
        index = self.groups["tempo"].start
        return np.exp(self.scale[index] * z[..., index])

    def arrays(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Arrays of the policies at many z at once, at the tempo of `policy0`.

        At a tempo of one they equal those of `policy` up to rounding.

        Args:
            z: Requested coordinates. Shape (B, size).

        Returns:
            Positive definite stiffness (B, n, 3, 3), attractors and rotation attractors (B, n, 3).
        """
        delta = self.scale * np.asarray(z, dtype=float)
        stiffness = self._stiffness(delta)
        if "stiffness" in self.groups:
            each = stiffness.reshape(-1, 3, 3)  # a view
            bad = np.linalg.eigvalsh(symmetric_part(each))[:, 0] < self.stiffness_min
            each[bad] = self._raised(each[bad])
        return stiffness, *self._attractors(delta)

    def clip(self, z: np.ndarray) -> np.ndarray:
        """Coordinates of the nearest policy with positive definite stiffness matrices.

        Eigenvalues of the symmetric part below `stiffness_min` are raised to it, the skew part is
        kept; matrices above the limit keep their coordinates bit for bit. Convex combinations of
        clipped vectors need no clipping. Shape (size,).
        """
        z = self._checked(z).copy()
        if "stiffness" not in self.groups:
            return z
        stiffness = self._stiffness(self.scale * z)
        low = np.linalg.eigvalsh(symmetric_part(stiffness))[:, 0]  # (n,)
        # A clipped matrix may be below the limit by a rounding error; do not clip it again.
        bad = low < self.stiffness_min * (1.0 - 1e-9)
        if bad.any():
            raised = self._raised(stiffness[bad])
            block = z[self.groups["stiffness"]].reshape(self._n, -1)  # a view into z
            difference = self._entries(raised) - self._entries(self.policy0.stiffness[bad])
            scale = self.scale[self.groups["stiffness"]][0]
            block[bad] = difference.reshape(-1, block.shape[1]) / scale
        return z

    def _checked(self, z: np.ndarray) -> np.ndarray:
        """Coordinates as floats; ValueError if the shape is wrong or a value is not finite."""
        z = np.asarray(z, dtype=float)
        if z.shape != (self.size,):
            raise ValueError(f"z has shape {z.shape}, variant {self.variant!r} has ({self.size},)")
        if not np.isfinite(z).all():
            raise ValueError(f"z is not finite: {z[~np.isfinite(z)][:3]}")
        return z

    def _entries(self, stiffness: np.ndarray) -> np.ndarray:
        """Learnt entries of matrices (m, 3, 3), flattened."""
        if self._layout.symmetric:
            stiffness = symmetric_part(stiffness)
        columns = [stiffness[:, row, column] for row, column in self._layout.entries]
        return np.stack(columns, axis=1).ravel()

    def _stiffness(self, delta: np.ndarray) -> np.ndarray:
        """Stiffness matrices of policy0 moved by delta (..., size). Shape (..., n, 3, 3)."""
        batch = delta.shape[:-1]
        stiffness = np.broadcast_to(self.policy0.stiffness, (*batch, self._n, 3, 3)).copy()
        if self._layout.entries:
            moved = delta[..., self.groups["stiffness"]].reshape(*batch, self._n, -1)
            for k, (row, column) in enumerate(self._layout.entries):
                stiffness[..., row, column] += moved[..., k]
                if self._layout.symmetric and row != column:
                    stiffness[..., column, row] += moved[..., k]
        return stiffness

    def _attractors(self, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Attractors and rotation attractors of policy0 moved by delta. Shape (..., n, 3) each."""
        batch, axes = delta.shape[:-1], self._layout.axes
        shape = (*batch, self._n, 3)
        attractors = np.broadcast_to(self.policy0.attractors, shape).copy()
        attractors[..., axes] += delta[..., self.groups["attractors"]].reshape(*batch, self._n, -1)
        rotation = np.broadcast_to(self.policy0.rotation_attractors, shape).copy()
        axes = self._layout.rotation_axes
        if axes:
            rotation[..., axes] += delta[..., self.groups["rotation"]].reshape(*batch, self._n, -1)
        for direction in self._directions:
            step = delta[..., self.groups[direction.name], np.newaxis]  # (..., 1, 1)
            attractors += step * direction.attractors
            rotation += step * direction.rotation
        return attractors, rotation

    def _raised(self, stiffness: np.ndarray) -> np.ndarray:
        """Make matrices (m, 3, 3) positive definite, changing only learnt entries."""
        if self.variant != "planar":
            return positive_definite(stiffness, self.stiffness_min)
        # K_yy and the coupling b of y to x and z are fixed. K - k_min 1 is positive semidefinite if
        # and only if the Schur complement P - k_min 1 - b b^T / (K_yy - k_min) is: clip the latter.
        symmetric = symmetric_part(stiffness)
        raised = stiffness.copy()
        for k, matrix in enumerate(symmetric):
            b = matrix[[0, 2], 1]
            coupling = np.outer(b, b) / (matrix[1, 1] - self.stiffness_min)
            uncoupled = np.diag([0.0, matrix[1, 1], 0.0])
            uncoupled[_XZ] = matrix[_XZ] - coupling
            clipped = positive_definite(uncoupled[np.newaxis], self.stiffness_min)[0]
            raised[k][_XZ] += clipped[_XZ] - uncoupled[_XZ]
        return raised
