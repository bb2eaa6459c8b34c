# SPDX-License-Identifier: Apache-2.0
"""Parametrization of a policy: its learnt parameters and their exploration noise.

Stiffness is several hundred 1/s^2 and attractors are tenths of a metre, so "the sigma_i are
different" ([Kormushev2010], footnote 3). Hence theta = theta0 + scale * z with one scale per group,
and every learner explores z with unit standard deviation. A task chooses the groups; it may add its
own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from wam_power_ros import rotations
from wam_power_ros.learning.dmp import positive_definite
from wam_power_ros.learning.policy import Policy, at_tempo, read_only, symmetric_part

# Smallest eigenvalue of a sampled K_i, as a fraction of the smallest one of the demonstration [1]
EIGENVALUE_FLOOR = 0.1
MODES = 4  # smooth changes of an axis, from a shift to one and a half waves
FORMS = ("full", "symmetric", "diagonal")  # of the learnt part of a stiffness matrix


class NoiseScales(BaseModel):
    """Standard deviation of the exploration noise of each group of parameters."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Of every entry of K_i, as a fraction of the policy's mean stiffness [1]
    stiffness: float = Field(gt=0.0, le=1.0)
    attractor: float = Field(gt=0.0, le=1.0)  # of every entry of mu_i [m]
    rotation: float = Field(gt=0.0, le=1.0)  # of every entry of r_i [rad]


class Arrays(NamedTuple):
    """Arrays of one policy of n spring-dampers, or of many at once."""

    stiffness: np.ndarray  # K_i [1/s^2], shape (..., n, 3, 3)
    attractors: np.ndarray  # mu_i [m], shape (..., n, 3)
    rotation: np.ndarray  # r_i [rad], shape (..., n, 3)

    def turned(self, heading: float) -> Arrays:
        """The same in axes that are turned about the vertical by a heading [rad]."""
        if heading == 0.0:
            return self
        turn = rotations.exp(np.array([0.0, 0.0, heading]))
        stiffness, attractors, rotation = self
        return Arrays(turn.T @ stiffness @ turn, attractors @ turn, rotation @ turn)


@dataclass(frozen=True, eq=False)
class Group:
    """Learnt parameters of one kind, k of them; here one, which changes no array.

    Attributes:
        noise: Standard deviation of the exploration noise, in units of a parameter.
        name: Name, unique in a parametrization.
    """

    noise: float
    name: str

    def values(self, policy: Policy) -> np.ndarray:
        """Parameters of a policy. Shape (k,)."""
        return np.zeros(1)

    def scale(self, policy: Policy) -> float:
        """Standard deviation of the exploration noise around a policy, in units of a parameter."""
        return self.noise

    def move(self, arrays: Arrays, delta: np.ndarray) -> None:
        """Change the parameters by delta (..., k), in place."""


@dataclass(frozen=True, eq=False)
class Stiffness(Group):
    """Entries of each K_i.

    Attributes:
        noise: Noise of every entry, as a fraction of the policy's mean stiffness [1].
        form: "full", "symmetric" (entries (i, j) and (j, i) change together) or "diagonal".
        axes: Axes of the learnt entries: all three, or two that span a plane.

    Raises:
        ValueError: The form is unknown, or the number of axes is wrong.
    """

    name: str = field(default="stiffness", init=False)
    form: str = "full"
    axes: tuple[int, ...] = (0, 1, 2)

    def __post_init__(self) -> None:
        if self.form not in FORMS:
            raise ValueError(f"form {self.form!r} is not one of {', '.join(FORMS)}")
        if len(set(self.axes)) not in (2, 3):
            raise ValueError(f"axes {self.axes} must be two or three")

    @property
    def entries(self) -> list[tuple[int, int]]:
        """Learnt entries, row and column."""
        pairs = [(i, j) for i in self.axes for j in self.axes]
        if self.form == "full":
            return pairs
        upper = [(i, j) for i, j in pairs if i < j and self.form == "symmetric"]
        return [(i, i) for i in self.axes] + upper

    def entries_of(self, stiffness: np.ndarray) -> np.ndarray:
        """Learnt entries of matrices (m, 3, 3). Shape (m k / n,)."""
        if self.form == "symmetric":
            stiffness = symmetric_part(stiffness)
        columns = [stiffness[:, row, column] for row, column in self.entries]
        return np.stack(columns, axis=1).ravel()

    def values(self, policy: Policy) -> np.ndarray:
        """See `Group`."""
        return self.entries_of(policy.stiffness)

    def scale(self, policy: Policy) -> float:
        """See `Group`."""
        symmetric = symmetric_part(policy.stiffness)  # (n, 3, 3)
        return self.noise * float(np.trace(symmetric, axis1=1, axis2=2).mean() / 3.0)

    def move(self, arrays: Arrays, delta: np.ndarray) -> None:
        """See `Group`."""
        entries, stiffness = self.entries, arrays.stiffness
        moved = delta.reshape(*delta.shape[:-1], -1, len(entries))
        for k, (row, column) in enumerate(entries):
            stiffness[..., row, column] += moved[..., k]
            if self.form == "symmetric" and row != column:
                stiffness[..., column, row] += moved[..., k]

    def raised(self, stiffness: np.ndarray, k_min: float) -> np.ndarray:
        """Make matrices (m, 3, 3) positive definite, changing only learnt entries.

        They are diagonal if the form is; k_min is that of `positive_definite`.
        """
        if len(self.axes) == 3:
            return positive_definite(stiffness, k_min)
        # The entry K_ff of the other axis and its coupling b are fixed. K - k_min 1 is positive
        # semidefinite if and only if the Schur complement P - k_min 1 - b b^T / (K_ff - k_min) is:
        # clip the latter.
        (fixed,) = {0, 1, 2} - set(self.axes)
        plane = np.ix_(self.axes, self.axes)
        symmetric = symmetric_part(stiffness)
        raised = stiffness.copy()
        for k, matrix in enumerate(symmetric):
            b = matrix[self.axes, fixed]
            coupling = np.outer(b, b) / (matrix[fixed, fixed] - k_min)
            uncoupled = np.zeros((3, 3))
            uncoupled[fixed, fixed] = matrix[fixed, fixed]
            uncoupled[plane] = matrix[plane] - coupling
            clipped = positive_definite(uncoupled[np.newaxis], k_min)[0]
            raised[k][plane] += clipped[plane] - uncoupled[plane]
        return raised


@dataclass(frozen=True, eq=False)
class Attractors(Group):
    """Elements of each mu_i [m]."""

    name: str = field(default="attractors", init=False)
    axes: tuple[int, ...] = (0, 1, 2)

    def values(self, policy: Policy) -> np.ndarray:
        """See `Group`."""
        return policy.attractors[:, self.axes].ravel()

    def move(self, arrays: Arrays, delta: np.ndarray) -> None:
        """See `Group`."""
        moved = delta.reshape(*delta.shape[:-1], -1, len(self.axes))
        arrays.attractors[..., self.axes] += moved


@dataclass(frozen=True, eq=False)
class Rotation(Attractors):
    """Elements of each r_i [rad]."""

    name: str = field(default="rotation", init=False)

    def values(self, policy: Policy) -> np.ndarray:
        """See `Group`."""
        return policy.rotation_attractors[:, self.axes].ravel()

    def move(self, arrays: Arrays, delta: np.ndarray) -> None:
        """See `Group`."""
        super().move(arrays._replace(attractors=arrays.rotation), delta)


@dataclass(frozen=True, eq=False)
class Direction(Group):
    """One parameter that moves all attractors together along a fixed pattern.

    Attributes:
        attractors: Displacement of every mu_i for a parameter of one [m]. Shape (n, 3).
        rotation: Displacement of every r_i for a parameter of one [rad]. Shape (n, 3).

    Raises:
        ValueError: If the noise is not positive, or a pattern is not finite or of another shape.
    """

    attractors: np.ndarray
    rotation: np.ndarray

    def __post_init__(self) -> None:
        if not 0.0 < self.noise < np.inf:
            raise ValueError(f"{self.name}: noise = {self.noise} must be positive")
        shape = (len(self.attractors), 3)
        for name in ("attractors", "rotation"):
            pattern = read_only(f"{self.name}: {name}", getattr(self, name), shape)
            object.__setattr__(self, name, pattern)

    def values(self, policy: Policy) -> np.ndarray:
        """See `Group`."""
        if (n := policy.basis.count) != len(self.attractors):
            raise ValueError(
                f"direction {self.name!r} has {len(self.attractors)} attractors, "
                f"policy {policy.id!r} has {n}"
            )
        return np.zeros(1)

    def move(self, arrays: Arrays, delta: np.ndarray) -> None:
        """See `Group`."""
        step = delta[..., np.newaxis]  # (..., 1, 1)
        np.add(arrays.attractors, step * self.attractors, out=arrays.attractors)
        np.add(arrays.rotation, step * self.rotation, out=arrays.rotation)


@dataclass(frozen=True, eq=False)
class Tempo(Group):
    """Logarithm of the tempo, see `at_tempo`."""

    name: str = field(default="tempo", init=False)


class Parametrization:
    """Map from coordinates z to policies around one demonstrated policy.

    Everything that no group moves is as in `policy0`.

    Attributes:
        size: Number of parameters.
        theta0: Parameters of `policy0`, in the units of the groups. Shape (size,).
        scale: Standard deviation of the exploration noise, in the units of theta. Shape (size,).
        groups: Name of each group -> its slice in theta and z.
        stiffness_min: Smallest eigenvalue of the symmetric part of a sampled K_i [1/s^2].
    """

    def __init__(self, policy0: Policy, groups: Sequence[Group], heading: float = 0.0) -> None:
        """Combine groups of parameters, in the order of theta.

        The groups, and theta, are in axes that are turned about the vertical by a heading [rad].

        Raises:
            ValueError: A group does not fit the policy, or two have the same name.
        """
        self.policy0, self._heading = policy0, heading
        policy0 = self._own = seen_from(policy0, heading)
        symmetric = symmetric_part(policy0.stiffness)  # (n, 3, 3)
        self.stiffness_min = EIGENVALUE_FLOOR * float(np.linalg.eigvalsh(symmetric).min())
        self._members = tuple(groups)
        self._stiffness = next((each for each in groups if isinstance(each, Stiffness)), None)
        values = [each.values(policy0) for each in groups]
        scales = [np.full(len(v), g.scale(policy0)) for g, v in zip(groups, values, strict=True)]
        self.theta0, self.scale = np.concatenate(values), np.concatenate(scales)
        self.size = len(self.theta0)
        self.groups: dict[str, slice] = {}
        start = 0
        for group, value in zip(groups, values, strict=True):
            if group.name in self.groups:
                raise ValueError(f"name {group.name!r} is used by two groups")
            self.groups[group.name] = slice(start, start + len(value))
            start += len(value)
        self.theta0.setflags(write=False)
        self.scale.setflags(write=False)

    def theta(self, z: np.ndarray) -> np.ndarray:
        """Parameters in their own units, theta0 + scale * z. Shape (size,)."""
        return self.theta0 + self.scale * self._checked(z)

    def policy(self, z: np.ndarray, policy_id: str) -> tuple[Policy, np.ndarray]:
        """Policy at z (size,), with every stiffness matrix positive definite.

        Returned with its coordinates, `clip(z)`, which are the ones to learn from.
        `policy(clip(z), policy_id)` is the same policy, bit for bit.
        """
        z = self.clip(z)
        stiffness, attractors, rotation = self._moved(z).turned(-self._heading)
        policy = replace(
            self.policy0,
            id=policy_id,
            stiffness=stiffness,
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

    def arrays(self, z: np.ndarray) -> Arrays:
        """Arrays of the policies at many z (B, size) at once, at the tempo of `policy0`.

        At a tempo of one they equal those of `policy` up to rounding.
        """
        arrays = self._moved(np.asarray(z, dtype=float))
        if self._stiffness is not None:
            each = arrays.stiffness.reshape(-1, 3, 3)  # a view
            bad = np.linalg.eigvalsh(symmetric_part(each))[:, 0] < self.stiffness_min
            each[bad] = self._stiffness.raised(each[bad], self.stiffness_min)
        return arrays.turned(-self._heading)

    def clip(self, z: np.ndarray) -> np.ndarray:
        """Coordinates of the nearest policy with positive definite stiffness matrices.

        Eigenvalues of the symmetric part below `stiffness_min` are raised to it, the skew part is
        kept; matrices above the limit keep their coordinates bit for bit. Convex combinations of
        clipped vectors need no clipping. Shape (size,).
        """
        z = self._checked(z).copy()
        if (group := self._stiffness) is None:
            return z
        stiffness = self._moved(z).stiffness
        low = np.linalg.eigvalsh(symmetric_part(stiffness))[:, 0]  # (n,)
        # A clipped matrix may be below the limit by a rounding error; do not clip it again.
        bad = low < self.stiffness_min * (1.0 - 1e-9)
        if bad.any():
            raised = group.raised(stiffness[bad], self.stiffness_min)
            block = z[self.groups[group.name]].reshape(len(low), -1)  # a view into z
            difference = group.entries_of(raised) - group.entries_of(self._own.stiffness[bad])
            scale = self.scale[self.groups[group.name]][0]
            block[bad] = difference.reshape(-1, block.shape[1]) / scale
        return z

    def modes(self) -> np.ndarray:
        """Smooth changes of the whole movement, each of one axis of attractors or rotation.

        They are cosines over the springs, by which an attractor is moved by a standard deviation of
        the exploration (root mean square). Shape (k, size), with no rows where none is learnt.
        """
        n = self.policy0.basis.count
        waves = np.cos(np.pi * np.outer(range(min(MODES, n)), (np.arange(n) + 0.5) / n))
        waves /= np.sqrt((waves**2).mean(axis=1, keepdims=True))
        found = np.empty((0, self.size))
        for group in self._members:
            axes = len(group.axes) if isinstance(group, Attractors) else 0
            for axis in range(axes):
                rows = np.zeros((len(waves), self.size))
                rows[:, self.groups[group.name]][:, axis::axes] = waves
                found = np.vstack([found, rows])
        return found

    def _checked(self, z: np.ndarray) -> np.ndarray:
        """Coordinates as floats; ValueError if the shape is wrong or a value is not finite."""
        z = np.asarray(z, dtype=float)
        if z.shape != (self.size,):
            raise ValueError(f"z has shape {z.shape}, the parameters have ({self.size},)")
        if not np.isfinite(z).all():
            raise ValueError(f"z is not finite: {z[~np.isfinite(z)][:3]}")
        return z

    def _moved(self, z: np.ndarray) -> Arrays:
        """Arrays of policy0 in the axes of the groups, moved to z (..., size)."""
        delta, policy0 = self.scale * z, self._own
        own = (policy0.stiffness, policy0.attractors, policy0.rotation_attractors)
        arrays = Arrays(*(np.broadcast_to(a, (*z.shape[:-1], *a.shape)).copy() for a in own))
        for group, part in zip(self._members, self.groups.values(), strict=True):
            group.move(arrays, delta[..., part])
        return arrays


def seen_from(policy: Policy, heading: float) -> Policy:
    """Springs of a policy in axes that are turned about the vertical by a heading [rad]."""
    own = Arrays(policy.stiffness, policy.attractors, policy.rotation_attractors)
    stiffness, attractors, rotation = own.turned(heading)
    return replace(policy, stiffness=stiffness, attractors=attractors, rotation_attractors=rotation)


def parametrization_of(
    policy0: Policy, variant: str, noise: NoiseScales, others: Sequence[Group] = ()
) -> Parametrization:
    """Stiffness and attractors in all directions, as in the paper, and `others`.

    The variant is the form of the stiffness, one of `FORMS`, of which "diagonal" sets the other
    entries of `policy0` to zero; or "attractors", by which no stiffness is learnt.
    """
    if variant == "diagonal":
        policy0 = replace(policy0, stiffness=policy0.stiffness * np.eye(3))
    stiffness = [] if variant == "attractors" else [Stiffness(noise.stiffness, variant)]
    return Parametrization(policy0, [*stiffness, Attractors(noise.attractor), *others])
