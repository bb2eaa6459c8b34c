# SPDX-License-Identifier: Apache-2.0
"""A movement and its improvement in three calls: without an arm, a task, a file or ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from wam_power_ros.learning import dmp
from wam_power_ros.learning.demonstration import from_positions
from wam_power_ros.learning.dmp import FitSettings, reproduce_many
from wam_power_ros.learning.learner import Learner
from wam_power_ros.learning.parametrization import NoiseScales, parametrization_of
from wam_power_ros.learning.policy import PERIOD, Policy, read_only
from wam_power_ros.learning.power import Power

# Of a movement of 1 s, so that a slower one is the same in its own time: those of the flip.
DAMPING, STIFFNESS = 27.0, (108.0, 361.0)  # [1/s], [1/s^2]
NOISE = NoiseScales(stiffness=0.2, attractor=0.02, rotation=0.1)
LearnerOf = Callable[[int, np.random.Generator], Learner]


@dataclass(frozen=True, eq=False)
class Attempt:
    """A policy that was tried, its return, and the mean that the learner has drawn from it."""

    policy: Policy
    ret: float
    mean: Policy


def fit(t: np.ndarray, x: np.ndarray, count: int = 8) -> Policy:
    """Fit a mixture of spring-dampers (Eq. 1) to a movement of a point; see `dmp.fit`.

    Args:
        t: Increasing times [s]. Shape (N,).
        x: Positions [m]. Shape (N, 3).

    Raises:
        ValueError: A shape is wrong, a value not finite, a time does not increase, or the movement
            is too short for so many spring-dampers.
    """
    t = read_only("t", t, (np.size(t),))
    x = read_only("x", x, (len(t), 3))
    if len(t) < 3 or not (np.diff(t) > 0.0).all():
        raise ValueError("t must have at least 3 times [s] that increase")
    duration = float(t[-1] - t[0])
    grid = np.arange(round(duration / PERIOD) + 1) * PERIOD
    even = np.column_stack([np.interp(grid, t - t[0], axis) for axis in x.T])
    settings = FitSettings(
        count=count,
        width=0.5,
        k_min=STIFFNESS[0] / duration**2,
        k_max=STIFFNESS[1] / duration**2,
        damping=DAMPING / duration,
    )
    return dmp.fit([from_positions(even, PERIOD)], settings, "fitted")


def path(policy: Policy, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Movement of a policy (Eq. 1) from rest at a start (3,) [m].

    Returns:
        Times [s], shape (N,), and positions [m], shape (N, 3).
    """
    steps = round(policy.basis.duration / PERIOD) + 1
    stiffness, attractors = policy.stiffness[np.newaxis], policy.attractors[np.newaxis]
    given = policy.basis, stiffness, attractors, policy.damping
    paths, _ = reproduce_many(*given, np.asarray(start, float), np.zeros(3), steps, PERIOD)
    return np.arange(steps) * PERIOD, paths[0]


def practise(
    return_of: Callable[[Policy], float],
    policy: Policy,
    rng: np.random.Generator,
    rollouts: int = 50,
    noise: NoiseScales = NOISE,
    learner: LearnerOf = lambda size, rng: Power(size, Power.Settings(), rng),
) -> Iterator[Attempt]:
    """Improve a policy by trial and error, by PoWER (Eqs. 2-3) unless another learner is given.

    Args:
        return_of: Executes a policy and tells its return, not negative: higher is better.
        policy: Policy to begin with, which is the first attempt.
        learner: Makes a learner of so many parameters.

    Yields:
        One attempt after another; the `mean` of the last one is what was learnt.
    """
    own = parametrization_of(policy, "full", noise)
    found = learner(own.size, rng)
    for number in range(rollouts):
        z = own.clip(found.ask()) if number else np.zeros(own.size)
        tried, _ = own.policy(z, f"attempt-{number + 1}")
        ret = float(return_of(tried))
        found.tell(z, ret)
        yield Attempt(tried, ret, own.policy(own.clip(found.mean), "learnt")[0])
