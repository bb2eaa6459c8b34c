# SPDX-License-Identifier: Apache-2.0
"""Scenario of reaching: demonstrations of a movement and a sphere in its way (Sec. III-A).

The paper gives neither. Demonstrations are random here (`synthetic`), the sphere is on their mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from wam_power_ros.learning.demonstration import from_positions
from wam_power_ros.learning.dmp import fit, reproduce_many
from wam_power_ros.learning.policy import Policy
from wam_power_ros.tasks.reach.paths import STEPS, stopped_paths
from wam_power_ros.tasks.reach.returns import reaching_return
from wam_power_ros.tasks.reach.settings import REACH_FIT

RADIUS = 0.09  # radius of the sphere [m]
# Of the synthetic demonstrations:
DURATION = 2.0  # of a demonstration [s]
START, GOAL = np.array([0.4, -0.25, 0.3]), np.array([0.4, 0.25, 0.3])  # mean ends [m]
ARC = 0.06  # height of the mean demonstration above the straight line, half way [m]
SCATTER = 0.01  # standard deviation of a demonstration's ends and arc [m]
COUNT = 4  # demonstrations


@dataclass(frozen=True, eq=False)
class Scenario:
    """Demonstrations, a sphere at the midpoint of their mean, and the return of Eq. 4."""

    demonstrations: np.ndarray  # positions of the tool [m], shape (count, STEPS, 3)
    policy: Policy  # least-squares fit to the demonstrations, from which learning starts
    start: np.ndarray  # initial position of rollouts [m], shape (3,)

    @cached_property
    def demonstrated(self) -> np.ndarray:
        """Mean demonstration x_D [m], which ends at the goal. Shape (STEPS, 3)."""
        return self.demonstrations.mean(axis=0)

    @cached_property
    def obstacle(self) -> np.ndarray:
        """Centre of the sphere [m]. Shape (3,)."""
        return midpoint(self.demonstrations)

    @property
    def period(self) -> float:
        """Time between samples [s]."""
        return self.policy.basis.duration / (STEPS - 1)

    def free_paths(self, stiffness: np.ndarray, attractors: np.ndarray) -> np.ndarray:
        """Paths without the sphere, see `free_paths`. Shape (B, STEPS, 3)."""
        return free_paths(self.policy, self.start, stiffness, attractors)

    def stopped_paths(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Paths stopped at the sphere, and which did, see `tasks.reach.paths.stopped_paths`."""
        return stopped_paths(path, self.obstacle, RADIUS)

    def evaluate(
        self, stiffness: np.ndarray, attractors: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Noise-free returns and collisions of policies, see `free_paths`. Shape (B,) each."""
        path, collided = self.stopped_paths(self.free_paths(stiffness, attractors))
        return self.returns(path), collided

    @property
    def demonstrated_return(self) -> float:
        """Return (Eq. 4) of the policy fitted to the demonstrations."""
        policy = self.policy
        return float(self.evaluate(policy.stiffness[None], policy.attractors[None])[0][0])

    def returns(self, path: np.ndarray) -> np.ndarray:
        """Returns (Eq. 4) of paths (B, STEPS, 3). Shape (B,)."""
        return reaching_return(path, self.demonstrated, self.demonstrated[-1])


def free_paths(
    policy: Policy, start: np.ndarray, stiffness: np.ndarray, attractors: np.ndarray
) -> np.ndarray:
    """Paths of Eq. 1 from rest at `start` (3,) [m]. Shape (B, STEPS, 3).

    Basis and damping are those of `policy`. A path that diverges, because its stiffness is too
    large for the period, is clipped to 1 km.

    Args:
        policy: Policy with the basis and the damping of all.
        start: Initial position [m]. Shape (3,).
        stiffness: K_i of each [1/s^2]. Shape (B, n, 3, 3).
        attractors: mu_i of each [m]. Shape (B, n, 3).
    """
    basis, rest = policy.basis, np.zeros(3)
    period = basis.duration / (STEPS - 1)
    with np.errstate(over="ignore", invalid="ignore"):
        path, _ = reproduce_many(
            basis, stiffness, attractors, policy.damping, start, rest, STEPS, period
        )
    return np.clip(np.nan_to_num(path, nan=1e3), -1e3, 1e3)


def midpoint(demonstrations: np.ndarray) -> np.ndarray:
    """Midpoint in time of the mean of demonstrations (count, STEPS, 3) [m]. Shape (3,)."""
    return demonstrations.mean(axis=0)[(STEPS - 1) // 2 : STEPS // 2 + 1].mean(axis=0)


@cache
def synthetic() -> Scenario:
    """Demonstrations of a reach past an obstacle, in place of the paper's, which it omits.

    They are minimum-jerk movements along a line with an arc in z, half a metre in 2 s. The scatter
    is shifted to mean zero: the mean demonstration has exactly the given ends and arc.
    """
    s = np.linspace(0.0, 1.0, STEPS)
    s = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    offset = SCATTER * np.random.Generator(np.random.PCG64(0)).standard_normal((COUNT, 7))
    offset -= offset.mean(axis=0)
    first = START + offset[:, None, :3]  # (COUNT, 1, 3)
    last = GOAL + offset[:, None, 3:6]
    paths = first + s[:, None] * (last - first)
    paths[..., 2] += (ARC + offset[:, 6:]) * np.sin(np.pi * s)
    period = DURATION / (STEPS - 1)
    policy = fit([from_positions(path, period) for path in paths], REACH_FIT, "demonstration")
    return Scenario(paths, policy, START)
