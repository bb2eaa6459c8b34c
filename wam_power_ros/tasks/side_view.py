# SPDX-License-Identifier: Apache-2.0
"""Figure of a rollout of any task: tool and body from the side, and their heights over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, Rollout
from wam_power_ros.plotting import BLUE, ORANGE, legend, side_by_side

TOOL, BODY = BLUE, ORANGE
NORMAL_LENGTH = 0.06  # as drawn [m]


def side_view(rollout: Rollout, body: str) -> Figure:
    """A rollout in the plane of x and z, and its heights over time; `body` is a name.

    Arrows are the normals of the tool and of a body that turns: its body-fixed direction that
    coincides with the tool's normal in its first frame.
    """
    figure, (side, height) = side_by_side(8.6, 4.0, 1.15, 1.0)
    tool, seen = rollout.tool, rollout.body
    side.plot(tool.position[:, 0], tool.position[:, 2], color=TOOL, lw=1.5, label="tool")
    height.plot(tool.t, tool.position[:, 2], color=TOOL, lw=1.5, label="tool")
    if seen is not None and len(seen.t):
        dots: dict[str, Any] = {"ms": 2.5, "color": BODY}
        x, _, z = seen.position.T
        side.plot(x, z, "o--", lw=0.8, label=body, **dots)
        height.plot(seen.t, z, "o", label=f"{body} (camera)", **dots)
        if np.ptp(seen.quat_xyzw, axis=0).any():
            normals, every = rotations.matrix(tool.quat_xyzw)[:, :, 2], max(1, len(tool.t) // 18)
            first = normals[np.abs(tool.t - seen.t[0]).argmin()]
            _arrows(side, tool.position[::every], normals[::every], TOOL)
            _arrows(side, seen.position, body_normals(seen, first), BODY)
    side.set_aspect("equal", adjustable="datalim")
    side.set(xlabel="x, outward [m]", ylabel="z, up [m]")
    height.set(xlabel="time [s]", ylabel="z, up [m]")
    legend(side)
    legend(height)
    return figure


def body_normals(body: BodyPath, first: np.ndarray) -> np.ndarray:
    """Body-fixed direction of a body that is `first` (3,) in its first frame. Shape (M, 3)."""
    turns = rotations.matrix(body.quat_xyzw)  # (M, 3, 3)
    return turns @ (turns[0].T @ first)


def _arrows(axes: Axes, places: np.ndarray, normals: np.ndarray, color: str) -> None:
    """Draw normals (m, 3) at places (m, 3), in the x-z plane."""
    (x, _, z), (u, _, w) = places.T, NORMAL_LENGTH * normals.T
    as_data: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
    axes.quiver(x, z, u, w, color=color, width=0.004, alpha=0.8, **as_data)
