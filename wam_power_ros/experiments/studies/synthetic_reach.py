# SPDX-License-Identifier: Apache-2.0
"""Random demonstrations of a reach past an obstacle, in place of the paper's, which it omits."""

from __future__ import annotations

import numpy as np

from wam_power_ros.learning.demonstration import from_positions
from wam_power_ros.learning.dmp import fit
from wam_power_ros.tasks.reach.scenario import RADIUS, STEPS, Scenario, midpoint
from wam_power_ros.tasks.reach.settings import REACH_FIT


def synthetic(
    *,
    duration: float = 2.0,
    steps: int = STEPS,
    start: tuple[float, float, float] = (0.4, -0.25, 0.3),
    goal: tuple[float, float, float] = (0.4, 0.25, 0.3),
    arc: float = 0.06,
    scatter: float = 0.01,
    count: int = 4,
    radius: float = RADIUS,
    seed: int = 0,
) -> Scenario:
    """Draw minimum-jerk demonstrations along a line with an arc in z, half a metre in 2 s.

    The scatter is shifted to mean zero: the mean demonstration has exactly the given ends and arc.

    Args:
        duration: Duration of a demonstration [s].
        steps: Number of samples T of a rollout.
        start: Mean first position [m].
        goal: Mean last position [m].
        arc: Height of the mean demonstration above the straight line, half way [m].
        scatter: Standard deviation of a demonstration's ends and arc [m].
        count: Number of demonstrations.
        radius: Radius of the obstacle [m].
        seed: Seed of the scatter.

    Raises:
        ValueError: `steps`, `count`, `scatter` or `duration` is out of range.
    """
    if steps < 3 or count < 1 or scatter < 0.0 or not 0.0 < duration < np.inf:
        raise ValueError(
            f"steps = {steps} must be >= 3, count = {count} >= 1, scatter = {scatter} >= 0 "
            f"and duration = {duration} positive"
        )
    s = np.linspace(0.0, 1.0, steps)
    s = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    offset = scatter * np.random.Generator(np.random.PCG64(seed)).standard_normal((count, 7))
    offset -= offset.mean(axis=0)
    first = np.array(start) + offset[:, None, :3]  # (count, 1, 3)
    last = np.array(goal) + offset[:, None, 3:6]
    paths = first + s[:, None] * (last - first)
    paths[..., 2] += (arc + offset[:, 6:]) * np.sin(np.pi * s)
    period = duration / (steps - 1)
    policy = fit([from_positions(path, period) for path in paths], REACH_FIT, "demonstration")
    return Scenario(paths, period, radius, policy, np.array(start), midpoint(paths))
