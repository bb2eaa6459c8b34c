# SPDX-License-Identifier: Apache-2.0
"""Figures of the pancake task: pan and pancake from the side, with their normals."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.plotting import BLUE, GREEN, ORANGE, legend, side_by_side

PAN, PANCAKE = BLUE, ORANGE
NORMAL_LENGTH = 0.06  # as drawn [m]


def side_view(pan: EndEffectorPath, pancake: BodyPath, t_f: float | None = None) -> Figure:
    """A rollout seen from the side, as in Figs. 3-4 of the paper, and its heights over time.

    Arrows are the normals of pan and pancake; the pancake's normal is its body-fixed direction
    that coincides with the pan's normal in its first frame.

    Args:
        pan: Path of the pan.
        pancake: Path of the pancake; may be empty.
        t_f: Time at which the fall was assessed [s], marked if given.
    """
    figure, (side, height) = side_by_side(8.6, 4.0, 1.15, 1.0)
    every = max(1, round(len(pan.t) / 18))
    pan_normals = rotations.matrix(pan.quat_xyzw)[:, :, 2]  # (T, 3)
    side.plot(pan.position[:, 0], pan.position[:, 2], color=PAN, lw=1.5, label="pan")
    _arrows(side, pan.position[::every], pan_normals[::every], PAN)
    height.plot(pan.t, pan.position[:, 2], color=PAN, lw=1.5, label="pan")
    if len(pancake.t):
        dots: dict[str, Any] = {"ms": 2.5, "color": PANCAKE}
        x, _, z = pancake.position.T
        side.plot(x, z, "o--", lw=0.8, label="pancake", **dots)
        first = np.abs(pan.t - pancake.t[0]).argmin()
        _arrows(side, pancake.position, body_normals(pancake, pan_normals[first]), PANCAKE)
        height.plot(pancake.t, z, "o", label="pancake (camera)", **dots)
    if t_f is not None:
        height.axvline(t_f, color=GREEN, lw=0.8, ls=":", label="$t_f$")
    side.set_aspect("equal", adjustable="datalim")
    side.set(xlabel="x, outward [m]", ylabel="z, up [m]")
    height.set(xlabel="time [s]", ylabel="z, up [m]")
    legend(side)
    legend(height)
    return figure


def body_normals(pancake: BodyPath, first: np.ndarray) -> np.ndarray:
    """Body-fixed direction of the pancake that is `first` (3,) in its first frame. Shape (M, 3)."""
    turns = rotations.matrix(pancake.quat_xyzw)  # (M, 3, 3)
    return turns @ (turns[0].T @ first)


def _arrows(axes: Axes, places: np.ndarray, normals: np.ndarray, color: str) -> None:
    """Draw normals (m, 3) at places (m, 3), in the x-z plane."""
    (x, _, z), (u, _, w) = places.T, NORMAL_LENGTH * normals.T
    as_data: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
    axes.quiver(x, z, u, w, color=color, width=0.004, alpha=0.8, **as_data)
