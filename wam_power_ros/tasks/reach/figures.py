# SPDX-License-Identifier: Apache-2.0
"""Figure of a reach: paths around the obstacle."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from wam_power_ros.plotting import BLUE, GREEN, legend, side_by_side
from wam_power_ros.regions import Region

OBSTACLE = "#c8504f"


def executed(tool: np.ndarray, demonstrated: np.ndarray, obstacle: Region | None) -> Figure:
    """Executed path (T, 3) and demonstrated one (K, 3) [m], from the side and from above.

    Axes are those of `side_and_top`, about the begin of the demonstrated path.
    """
    figure, both = side_by_side(8.6, 4.0, 1.0, 1.0)
    start, views = demonstrated[0], side_and_top(demonstrated[-1] - demonstrated[0])
    for axes, view, aside in zip(both, views, ("up [m]", "aside [m]"), strict=True):
        axes.plot(*(view @ (demonstrated - start).T), color=BLUE, label="demonstrated")
        axes.plot(*(view @ (tool - start).T), color=GREEN, lw=2.0, label="executed")
        axes.plot(*(view @ (demonstrated[-1] - start)), "s", color=GREEN, ms=7, label="goal")
        if obstacle is not None:
            x, y = view @ (obstacle.centre - start)
            sphere = Circle((x, y), obstacle.radius, color=OBSTACLE, alpha=0.3, label="obstacle")
            axes.add_patch(sphere)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(xlabel="along the movement [m]", ylabel=aside)
    legend(both[0])
    return figure


def side_and_top(way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes of views of a movement by `way` (3,): along and up; along and left. Shapes (2, 3)."""
    level = way * np.array([1.0, 1.0, 0.0])
    length = float(np.linalg.norm(level))
    level = level / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return np.stack([level, up]), np.stack([level, np.cross(up, level)])
