# SPDX-License-Identifier: Apache-2.0
"""A movement that is demonstrated four times, and a sphere in its way (Sec. III-A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.dmp import fit, reproduce_many
from wam_power_ros.learning.policy import Policy
from wam_power_ros.tasks.reach.returns import reaching_return
from wam_power_ros.tasks.reach.settings import REACH_FIT

STEPS = 200  # T of Eq. 4
RADIUS = 0.09  # [m] of the sphere


@dataclass(frozen=True, eq=False)
class Scenario:
    """Demonstrations, one obstacle, one return (Eq. 4).

    Attributes:
        demonstrations: Positions [m]. Shape (count, T, 3).
        period: Time between samples [s].
        radius: Radius of the obstacle, a sphere [m]; 0 for none.
        policy: The least-squares fit, two primitives: where learning starts.
        start: Position at which rollouts begin [m]. Shape (3,).
        obstacle: Centre of the sphere [m]. Shape (3,).
        demonstrated: x_D, the mean demonstration [m]. Shape (T, 3).
        goal: x_G, its last position [m]. Shape (3,).

    Raises:
        ValueError: A shape or a value out of range.
    """

    demonstrations: np.ndarray
    period: float
    radius: float
    policy: Policy
    start: np.ndarray
    obstacle: np.ndarray
    demonstrated: np.ndarray = field(init=False)
    goal: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        paths = np.array(self.demonstrations, dtype=float)
        if paths.ndim != 3 or paths.shape[1] < 3 or paths.shape[2] != 3 or len(paths) < 1:
            raise ValueError(f"demonstrations {paths.shape} must be (count >= 1, T >= 3, 3)")
        if not 0.0 < self.period < np.inf:
            raise ValueError(f"period = {self.period} must be positive")
        if not 0.0 <= self.radius < np.inf:
            raise ValueError(f"radius = {self.radius} must be 0 or more")
        mean = paths.mean(axis=0)
        for name, array in (
            ("demonstrations", paths),
            ("demonstrated", mean),
            ("start", np.array(self.start, dtype=float)),
            ("goal", mean[-1].copy()),
            ("obstacle", np.array(self.obstacle, dtype=float)),
        ):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def steps(self) -> int:
        """Samples T of a rollout."""
        return len(self.demonstrated)

    def free(self, stiffness: np.ndarray, attractors: np.ndarray) -> np.ndarray:
        """Paths of Eq. 1 from the start, were there no obstacle.

        A stiffness too large for the period makes a path overflow; it is then far from everywhere.

        Args:
            stiffness: K_i of each policy, with the basis and damping of `policy`. (B, n, 3, 3).
            attractors: mu_i of each. Shape (B, n, 3).

        Returns:
            Positions [m]. Shape (B, T, 3).
        """
        basis, damping = self.policy.basis, self.policy.damping
        with np.errstate(over="ignore", invalid="ignore"):
            path, _ = reproduce_many(
                basis,
                stiffness,
                attractors,
                damping,
                self.start,
                np.zeros(3),
                self.steps,
                self.period,
            )
        return np.clip(np.nan_to_num(path, nan=1e3), -1e3, 1e3)

    def stopped(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Paths that stay at the last free sample before the obstacle, and who met it.

        The way between samples counts too: a fast rollout does not jump through the sphere.

        Args:
            path: [m]. Shape (B, T, 3). Not modified.

        Returns:
            Positions [m], shape (B, T, 3), and who collided, shape (B,).
        """
        step = np.diff(path, axis=1)  # (B, T-1, 3)
        away = self.obstacle - path[:, :-1]
        length = np.maximum((step**2).sum(axis=-1), 1e-300)
        share = np.clip((away * step).sum(axis=-1) / length, 0.0, 1.0)
        nearest = np.linalg.norm(away - share[..., None] * step, axis=-1)  # (B, T-1)
        hit = nearest < self.radius
        collided = hit.any(axis=1)
        last_free = np.where(collided, hit.argmax(axis=1), self.steps - 1)  # (B,)
        return held(path, last_free), collided

    def evaluate(
        self, stiffness: np.ndarray, attractors: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Noise-free returns (Eq. 4), and who collided; arguments of `free`. Shape (B,) each."""
        path, collided = self.stopped(self.free(stiffness, attractors))
        return self.worth(path), collided

    def worth(self, path: np.ndarray) -> np.ndarray:
        """Return (Eq. 4) of paths (B, T, 3). Shape (B,)."""
        return np.asarray(reaching_return(path, self.demonstrated, self.goal))


def middle(demonstrations: np.ndarray) -> np.ndarray:
    """Middle of the mean of demonstrations (count, T, 3): where the obstacle stands [m]. (3,)."""
    mean = np.asarray(demonstrations).mean(axis=0)
    half = (len(mean) - 1) // 2
    return np.asarray(0.5 * (mean[half] + mean[len(mean) // 2]))


def held(path: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Paths (B, T, 3) that stay at sample `last` (B,) of theirs from there on."""
    index = np.minimum(np.arange(path.shape[1]), last[:, None])  # (B, T)
    return np.take_along_axis(path, index[..., None], axis=1)


def taught(demonstrations: Sequence[Demonstration]) -> Scenario:
    """The tool's movements in demonstrations of an arm, stretched in time to their mean duration.

    The obstacle stands in the middle of the mean demonstration.

    Args:
        demonstrations: At least one.

    Raises:
        ValueError: A value out of range.
    """
    policy = fit(demonstrations, REACH_FIT, "demonstration")
    paths = stretched(demonstrations)
    start = demonstrations[0].position[0]  # where the tool is at the policy's q_start
    period = policy.basis.duration / (STEPS - 1)
    return Scenario(paths, period, RADIUS, policy, start, middle(paths))


def stretched(demonstrations: Sequence[Demonstration]) -> np.ndarray:
    """Positions of the tool at `STEPS` instants, evenly over each demonstration [m].

    Returns:
        Shape (count, STEPS, 3).
    """
    grid = np.linspace(0.0, 1.0, STEPS)
    return np.stack(
        [
            np.stack([np.interp(grid, d.t / d.duration, x) for x in d.position.T], axis=1)
            for d in demonstrations
        ]
    )
