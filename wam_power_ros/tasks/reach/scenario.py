# SPDX-License-Identifier: Apache-2.0
"""Scenario of reaching: demonstrations of a movement and a sphere in its way (Sec. III-A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.dmp import fit, reproduce_many
from wam_power_ros.learning.policy import Policy
from wam_power_ros.tasks.reach.returns import reaching_return
from wam_power_ros.tasks.reach.settings import REACH_FIT

STEPS = 200  # number of samples T of Eq. 4
RADIUS = 0.09  # radius of the sphere [m]


@dataclass(frozen=True, eq=False)
class Scenario:
    """Demonstrations, a spherical obstacle and the return of Eq. 4.

    Raises:
        ValueError: If a shape is wrong or a value is out of range.
    """

    demonstrations: np.ndarray  # positions of the tool [m], shape (count, T, 3)
    period: float  # between samples [s]
    radius: float  # of the obstacle, a sphere [m]; 0 for none
    policy: Policy  # least-squares fit to the demonstrations, from which learning starts
    start: np.ndarray  # initial position of rollouts [m], shape (3,)
    obstacle: np.ndarray  # centre of the sphere [m], shape (3,)
    demonstrated: np.ndarray = field(init=False)  # mean demonstration x_D [m], shape (T, 3)
    goal: np.ndarray = field(init=False)  # its last position x_G [m], shape (3,)

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
        """Number of samples T of a rollout."""
        return len(self.demonstrated)

    def free_paths(self, stiffness: np.ndarray, attractors: np.ndarray) -> np.ndarray:
        """Paths of Eq. 1 from `start` without the obstacle.

        A path that diverges, because its stiffness is too large for the period, is clipped to 1 km.

        Args:
            stiffness: K_i of each policy [1/s^2]. Shape (B, n, 3, 3).
            attractors: mu_i of each policy [m]. Shape (B, n, 3).

        Returns:
            Positions [m]. Shape (B, T, 3).
        """
        basis, damping = self.policy.basis, self.policy.damping
        with np.errstate(over="ignore", invalid="ignore"):
            start, rest = self.start, np.zeros(3)
            path, _ = reproduce_many(
                basis, stiffness, attractors, damping, start, rest, self.steps, self.period
            )
        return np.clip(np.nan_to_num(path, nan=1e3), -1e3, 1e3)

    def stopped_paths(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stop paths at their last sample before the obstacle.

        The segments between samples are checked: a fast rollout does not jump through the sphere.

        Args:
            path: Positions [m]. Shape (B, T, 3). Not modified.

        Returns:
            Positions [m], shape (B, T, 3), and whether each path collided, shape (B,).
        """
        step = np.diff(path, axis=1)  # (B, T-1, 3)
        offset = self.obstacle - path[:, :-1]
        length2 = np.maximum((step**2).sum(axis=-1), 1e-300)
        share = np.clip((offset * step).sum(axis=-1) / length2, 0.0, 1.0)
        distance = np.linalg.norm(offset - share[..., None] * step, axis=-1)  # (B, T-1)
        hit = distance < self.radius
        collided = hit.any(axis=1)
        last_free = np.where(collided, hit.argmax(axis=1), self.steps - 1)  # (B,)
        return held(path, last_free), collided

    def evaluate(
        self, stiffness: np.ndarray, attractors: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Noise-free returns and collisions of policies, see `free_paths`. Shape (B,) each."""
        path, collided = self.stopped_paths(self.free_paths(stiffness, attractors))
        return self.returns(path), collided

    def returns(self, path: np.ndarray) -> np.ndarray:
        """Returns (Eq. 4) of paths (B, T, 3). Shape (B,)."""
        return np.asarray(reaching_return(path, self.demonstrated, self.goal))


def midpoint(demonstrations: np.ndarray) -> np.ndarray:
    """Midpoint in time of the mean of demonstrations (count, T, 3) [m]. Shape (3,)."""
    mean = np.asarray(demonstrations).mean(axis=0)
    half = (len(mean) - 1) // 2
    return np.asarray(0.5 * (mean[half] + mean[len(mean) // 2]))


def held(path: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Hold paths (B, T, 3) at their sample `last` (B,) from there on. Shape (B, T, 3)."""
    index = np.minimum(np.arange(path.shape[1]), last[:, None])  # (B, T)
    return np.take_along_axis(path, index[..., None], axis=1)


def scenario_of(demonstrations: Sequence[Demonstration]) -> Scenario:
    """Scenario of an arm's demonstrations, scaled in time to their mean duration.

    The obstacle is at the midpoint of the mean demonstration.

    Raises:
        ValueError: If there is no demonstration or a value is out of range.
    """
    policy = fit(demonstrations, REACH_FIT, "demonstration")
    paths = resampled(demonstrations)
    start = demonstrations[0].position[0]  # tool position at the q_start of the policy
    period = policy.basis.duration / (STEPS - 1)
    return Scenario(paths, period, RADIUS, policy, start, midpoint(paths))


def resampled(demonstrations: Sequence[Demonstration]) -> np.ndarray:
    """Tool positions at STEPS evenly spaced times of each demonstration [m]. (count, STEPS, 3)."""
    grid = np.linspace(0.0, 1.0, STEPS)
    return np.stack(
        [
            np.stack([np.interp(grid, d.t / d.duration, x) for x in d.position.T], axis=1)
            for d in demonstrations
        ]
    )
