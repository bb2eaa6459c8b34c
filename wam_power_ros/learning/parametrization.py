# SPDX-License-Identifier: Apache-2.0
"""What of a policy is learnt: policy <-> coordinates z in which exploration has unit noise.

Stiffness is some hundred 1/s^2 and attractors are some tenths of a metre, so "the sigma_i are
different" ([Kormushev2010], footnote 3). A learner sees neither: theta = theta0 + scale * z with
one scale a group, and every learner explores z with standard deviation one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from wam_power_ros.learning.dmp import positive_definite
from wam_power_ros.learning.policy import Policy

FLOOR = 0.1  # smallest stiffness a sample may have, of the smallest one of the demonstration
CATCH_PROFILE = (0.5, 1.0, 1.0)  # what a catch shift of one moves the last three attractors by
TURN_OF_FLICK = 2.0  # [rad] what a toss turns more for a flick of one, as measured on wrist flicks
_XZ = np.ix_((0, 2), (0, 2))


class NoiseScales(BaseModel):
    """One standard deviation of exploration for each group of parameters.

    Attributes:
        stiffness: of every entry of K_i, as a fraction of the policy's mean stiffness [1].
        attractor: of every entry of mu_i [m].
        rotation: of every entry of r_i [rad].
        flick: of the flick [1].
        catch_shift: of the catch shift [m].
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    stiffness: float = Field(gt=0.0, le=1.0)
    attractor: float = Field(gt=0.0, le=1.0)
    rotation: float = Field(gt=0.0, le=1.0)
    flick: float = Field(default=0.05, gt=0.0, le=1.0)
    catch_shift: float = Field(gt=0.0, le=1.0)


@dataclass(frozen=True)
class _Layout:
    entries: tuple[tuple[int, int], ...]  # of each K_i
    paired: bool  # an entry (row, column) moves (column, row) with it
    axes: tuple[int, ...]  # of each mu_i
    rotation_axes: tuple[int, ...] = ()  # of each r_i
    catch: bool = False  # and a flick


_DIAGONAL = ((0, 0), (1, 1), (2, 2))
_LAYOUTS = {
    "full": _Layout(tuple((i, j) for i in range(3) for j in range(3)), False, (0, 1, 2)),
    "diagonal": _Layout(_DIAGONAL, False, (0, 1, 2)),
    "symmetric": _Layout((*_DIAGONAL, (0, 1), (0, 2), (1, 2)), True, (0, 1, 2)),
    "attractors": _Layout((), False, (0, 1, 2)),
    "planar": _Layout(((0, 0), (2, 2), (0, 2)), True, (0, 2), (1,), True),
}
VARIANTS = tuple(_LAYOUTS)


class Parameters:
    """The map between z and policies around one demonstrated policy.

    Variants, with n primitives:
        full: K_i and mu_i, 9 n + 3 n (the paper's).
        diagonal: the diagonal of K_i and mu_i, 3 n + 3 n; off-diagonal entries are zero.
        symmetric: the symmetric part of K_i and mu_i, 6 n + 3 n.
        attractors: mu_i, 3 n.
        planar: a movement in the x-z plane: K_xx, K_zz and K_xz, mu_x and mu_z, the rotation
            attractor about y (pitch), 6 n; one flick, which enlarges the demonstrated turning of
            the pan, r_i - r_1 about y, by that share; and one catch shift, which moves mu_x of the
            last three primitives by .5, 1 and 1.
    Everything else of the policy stays as it is in `policy0`.

    Attributes:
        size: number of parameters.
        variant: name of the variant.
        policy0: the policy at z = 0.
        theta0: parameters of that policy [1/s^2, m, rad, m]. Shape (size,)
        scale: one standard deviation of exploration, in the units of theta. Shape (size,)
        groups: where each group is in theta and z; a group without parameters is missing.
        names: what each entry is, such as "K3_xz" or "mu8_x". Length size.
        stiffness_min: smallest eigenvalue of the symmetric part of a sampled K_i [1/s^2].
    """

    def __init__(self, policy0: Policy, variant: str, noise: NoiseScales) -> None:
        """Take the parameters of `variant` around `policy0`.

        Raises:
            ValueError: unknown variant, or a catch shift asked of fewer than three primitives.
        """
        if variant not in _LAYOUTS:
            raise ValueError(f"variant {variant!r} is not one of {', '.join(VARIANTS)}")
        layout = _LAYOUTS[variant]
        n = policy0.basis.count
        if layout.catch and n < len(CATCH_PROFILE):
            raise ValueError(
                f"variant {variant!r} shifts the last {len(CATCH_PROFILE)} primitives, "
                f"policy {policy0.id!r} has {n}"
            )
        if variant == "diagonal":
            policy0 = replace(policy0, stiffness=policy0.stiffness * np.eye(3))
        symmetric = _symmetric_part(policy0.stiffness)  # (n, 3, 3)
        mean_stiffness = float(np.trace(symmetric, axis1=1, axis2=2).mean() / 3.0)
        self.variant = variant
        self.policy0 = policy0
        self.stiffness_min = FLOOR * float(np.linalg.eigvalsh(symmetric).min())
        self._layout = layout
        self._n = n

        blocks: list[tuple[str, np.ndarray, float, list[str]]] = []
        rows = range(1, n + 1)
        if layout.entries:
            names = [f"K{i}_{'xyz'[r]}{'xyz'[c]}" for i in rows for r, c in layout.entries]
            value = self._entries(policy0.stiffness)
            blocks.append(("stiffness", value, noise.stiffness * mean_stiffness, names))
        names = [f"mu{i}_{'xyz'[a]}" for i in rows for a in layout.axes]
        value = policy0.attractors[:, layout.axes].ravel()
        blocks.append(("attractors", value, noise.attractor, names))
        if layout.rotation_axes:
            names = [f"r{i}_{'xyz'[a]}" for i in rows for a in layout.rotation_axes]
            value = policy0.rotation_attractors[:, layout.rotation_axes].ravel()
            blocks.append(("rotation", value, noise.rotation, names))
        if layout.catch:
            blocks.append(("flick", np.zeros(1), noise.flick, ["flick"]))
            blocks.append(("catch_shift", np.zeros(1), noise.catch_shift, ["catch_shift"]))

        self.theta0 = np.concatenate([value for _, value, _, _ in blocks])
        self.scale = np.concatenate([np.full(len(v), scale) for _, v, scale, _ in blocks])
        self.names = tuple(name for _, _, _, names in blocks for name in names)
        self.size = len(self.theta0)
        self.groups: dict[str, slice] = {}
        start = 0
        for group, value, _, _ in blocks:
            self.groups[group] = slice(start, start + len(value))
            start += len(value)
        self.theta0.setflags(write=False)
        self.scale.setflags(write=False)

    def theta(self, z: np.ndarray) -> np.ndarray:
        """Parameters in their own units, theta0 + scale * z. Shape (size,)."""
        return self.theta0 + self.scale * self._checked(z)

    def policy(self, z: np.ndarray, id: str) -> tuple[Policy, np.ndarray]:
        """Policy at z, with every stiffness matrix positive definite.

        Args:
            z: wanted coordinates. Shape (size,)
            id: id of the new policy.

        Returns:
            The policy, and the coordinates it has: `clip(z)`. It is these that are to be learnt
            from. `policy(clip(z), id)` is the same policy, bit for bit.
        """
        z = self.clip(z)
        delta = self.scale * z
        attractors, rotation = self._attractors(delta)
        policy = replace(
            self.policy0,
            id=id,
            stiffness=self._stiffness(delta),
            attractors=attractors,
            rotation_attractors=rotation,
        )
        return policy, z

    def arrays(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What `policy` gives, for many at once, up to rounding.

        Args:
            z: wanted coordinates. Shape (B, size)

        Returns:
            Positive definite stiffness (B, n, 3, 3), attractors and rotation attractors (B, n, 3).
        """
        delta = self.scale * np.asarray(z, dtype=float)
        stiffness = self._stiffness(delta)
        if "stiffness" in self.groups:
            each = stiffness.reshape(-1, 3, 3)  # a view
            bad = np.linalg.eigvalsh(_symmetric_part(each))[:, 0] < self.stiffness_min
            each[bad] = self._raised(each[bad])
        return stiffness, *self._attractors(delta)

    def clip(self, z: np.ndarray) -> np.ndarray:
        """Coordinates of the nearest policy whose stiffness matrices are positive definite.

        Eigenvalues of the symmetric part below `stiffness_min` are raised to it, the skew part is
        left alone; matrices that need nothing keep their coordinates bit for bit. Shape (size,).
        Convex combinations of clipped vectors need no clipping.
        """
        z = self._checked(z).copy()
        if "stiffness" not in self.groups:
            return z
        stiffness = self._stiffness(self.scale * z)
        low = np.linalg.eigvalsh(_symmetric_part(stiffness))[:, 0]  # (n,)
        # A clipped matrix comes back a rounding error below the floor: that is no reason to clip.
        bad = low < self.stiffness_min * (1.0 - 1e-9)
        if bad.any():
            raised = self._raised(stiffness[bad])
            block = z[self.groups["stiffness"]].reshape(self._n, -1)  # a view into z
            difference = self._entries(raised) - self._entries(self.policy0.stiffness[bad])
            scale = self.scale[self.groups["stiffness"]][0]
            block[bad] = difference.reshape(-1, block.shape[1]) / scale
        return z

    def coordinates(self, policy: Policy) -> np.ndarray:
        """Coordinates z at which the learnt part is that of `policy`; flick and catch shift read 0.

        What the variant does not learn is not looked at. Shape (size,)

        Raises:
            ValueError: the policy has another number of primitives.
        """
        if policy.basis.count != self._n:
            raise ValueError(
                f"policy {policy.id!r} has {policy.basis.count} primitives, expected {self._n}"
            )
        parts = [
            self._entries(policy.stiffness),
            policy.attractors[:, self._layout.axes].ravel(),
            policy.rotation_attractors[:, self._layout.rotation_axes].ravel(),
            np.zeros(2 * int(self._layout.catch)),
        ]
        return (np.concatenate(parts) - self.theta0) / self.scale

    def _checked(self, z: np.ndarray) -> np.ndarray:
        z = np.asarray(z, dtype=float)
        if z.shape != (self.size,):
            raise ValueError(f"z has shape {z.shape}, variant {self.variant!r} has ({self.size},)")
        if not np.isfinite(z).all():
            raise ValueError(f"z is not finite: {z[~np.isfinite(z)][:3]}")
        return z

    def _entries(self, stiffness: np.ndarray) -> np.ndarray:
        """Learnt entries of matrices (m, 3, 3), flat."""
        if self._layout.paired:
            stiffness = _symmetric_part(stiffness)
        columns = [stiffness[:, row, column] for row, column in self._layout.entries]
        return np.stack(columns, axis=1).ravel() if columns else np.zeros(0)

    def _stiffness(self, delta: np.ndarray) -> np.ndarray:
        """Matrices of policy0 moved by delta (..., size). Shape (..., n, 3, 3)."""
        batch = delta.shape[:-1]
        stiffness = np.broadcast_to(self.policy0.stiffness, (*batch, self._n, 3, 3)).copy()
        if self._layout.entries:
            moved = delta[..., self.groups["stiffness"]].reshape(*batch, self._n, -1)
            for k, (row, column) in enumerate(self._layout.entries):
                stiffness[..., row, column] += moved[..., k]
                if self._layout.paired and row != column:
                    stiffness[..., column, row] += moved[..., k]
        return stiffness

    def _attractors(self, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Those of policy0 moved by delta (..., size), of place and rotation. (..., n, 3) each."""
        batch, axes = delta.shape[:-1], self._layout.axes
        shape = (*batch, self._n, 3)
        attractors = np.broadcast_to(self.policy0.attractors, shape).copy()
        attractors[..., axes] += delta[..., self.groups["attractors"]].reshape(*batch, self._n, -1)
        rotation = np.broadcast_to(self.policy0.rotation_attractors, shape).copy()
        axes = self._layout.rotation_axes
        if axes:
            rotation[..., axes] += delta[..., self.groups["rotation"]].reshape(*batch, self._n, -1)
        if self._layout.catch:
            demonstrated = self.policy0.rotation_attractors[:, axes]
            flick = delta[..., self.groups["flick"], np.newaxis]  # (..., 1, 1)
            rotation[..., axes] += flick * (demonstrated - demonstrated[0])
            shift = delta[..., self.groups["catch_shift"]]  # (..., 1)
            attractors[..., -len(CATCH_PROFILE) :, 0] += shift * np.array(CATCH_PROFILE)
        return attractors, rotation

    def _raised(self, stiffness: np.ndarray) -> np.ndarray:
        """Matrices (m, 3, 3) made positive definite without touching what is not learnt."""
        if self.variant != "planar":
            return positive_definite(stiffness, self.stiffness_min)
        # K_yy and the coupling b of y to x and z stay. K - k_min 1 is positive semidefinite exactly
        # when the Schur complement P - k_min 1 - b b^T / (K_yy - k_min) is: clip that one instead.
        symmetric = _symmetric_part(stiffness)
        raised = stiffness.copy()
        for k, matrix in enumerate(symmetric):
            b = matrix[[0, 2], 1]
            coupling = np.outer(b, b) / (matrix[1, 1] - self.stiffness_min)
            alone = np.diag([0.0, matrix[1, 1], 0.0])
            alone[_XZ] = matrix[_XZ] - coupling
            clipped = positive_definite(alone[np.newaxis], self.stiffness_min)[0]
            raised[k][_XZ] += clipped[_XZ] - alone[_XZ]
        return raised


def _symmetric_part(matrices: np.ndarray) -> np.ndarray:
    return 0.5 * (matrices + np.swapaxes(matrices, -1, -2))
