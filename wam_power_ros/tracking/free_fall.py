# SPDX-License-Identifier: Apache-2.0
"""Free fall in a path: reveals the true vertical of the motion capture."""

from __future__ import annotations

import numpy as np

from wam_power_ros.learning.rollout import BodyPath
from wam_power_ros.tracking.tracker import GRAVITY

FALL_SPAN = 0.2  # time over which a parabola is fitted [s]


def free_fall_acceleration(path: BodyPath) -> np.ndarray | None:
    """Acceleration of a body in the parts of its path that are clearly in free fall.

    It must point along -z; otherwise `up_axis` or `world_to_base` is wrong.

    Args:
        path: Path of a rollout.

    Returns:
        Mean over all fitted parabolas with an acceleration within 1 m/s^2 of gravity and an rms
        residual below 2 mm [m/s^2], shape (3,); None if there are fewer than two.
    """
    found = []
    for start in path.t:
        inside = (path.t >= start) & (path.t <= start + FALL_SPAN + 1e-6)
        t = path.t[inside] - start
        if len(t) < 5 or t[-1] < 0.8 * FALL_SPAN or np.diff(t).max() > 0.5 * FALL_SPAN:
            continue
        terms = np.stack([np.ones_like(t), t, 0.5 * t**2], axis=1)  # (m, 3)
        solution, *_ = np.linalg.lstsq(terms, path.position[inside], rcond=None)
        error = path.position[inside] - terms @ solution
        rms = np.sqrt(np.mean(np.sum(error**2, axis=1)))
        if rms < 2e-3 and abs(np.linalg.norm(solution[2]) - GRAVITY) < 1.0:
            found.append(solution[2])
    return np.mean(found, axis=0) if len(found) >= 2 else None
