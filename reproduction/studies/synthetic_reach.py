# SPDX-License-Identifier: Apache-2.0
"""Random demonstrations of a reach past an obstacle, in place of the paper's, which it omits."""

from __future__ import annotations

import numpy as np

from wam_power_ros.learning.demonstration import from_positions
from wam_power_ros.learning.dmp import fit
from wam_power_ros.tasks.reach.scenario import RADIUS, STEPS, Scenario, midpoint
from wam_power_ros.tasks.reach.settings import REACH_FIT

DURATION = 2.0  # of a demonstration [s]
START, GOAL = np.array([0.4, -0.25, 0.3]), np.array([0.4, 0.25, 0.3])  # mean ends [m]
ARC = 0.06  # height of the mean demonstration above the straight line, half way [m]
SCATTER = 0.01  # standard deviation of a demonstration's ends and arc [m]
COUNT = 4  # demonstrations


def synthetic() -> Scenario:
    """Draw minimum-jerk demonstrations along a line with an arc in z, half a metre in 2 s.

    The scatter is shifted to mean zero: the mean demonstration has exactly the given ends and arc.
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
    return Scenario(paths, period, RADIUS, policy, START, midpoint(paths))
