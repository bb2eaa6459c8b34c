# SPDX-License-Identifier: Apache-2.0
"""Flights of a pancake side by side, edge-on, as in Figs. 3 and 4 of the paper."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.plotting import GREEN, INK, STEEL, dress, shared_legend
from wam_power_ros.tasks.side_view import TOOL, body_normals

YELLOW, BROWN = "#e3a72f", "#7a4a1c"
PANCAKE_RADIUS, PAN_RADIUS = 0.09, 0.14  # as drawn [m]
MARGIN = 0.03  # around the drawn paths [m]


def flights(rollouts: Mapping[str, tuple[EndEffectorPath, BodyPath, float | None]]) -> Figure:
    """Pan and pancake seen from the side, with their normals.

    The pancake is drawn edge-on at camera frames, its two sides in two colours; the side that
    initially lies in the pan is brown. The pan is drawn at the same times.

    Args:
        rollouts: Title -> paths of pan and pancake, and t_f [s] or None.

    Raises:
        ValueError: There is no rollout.
    """
    if not rollouts:
        raise ValueError("a figure of flights must have at least one rollout, got none")
    pans = np.concatenate([pan.position[:, [0, 2]] for pan, _, _ in rollouts.values()])
    pancakes = [pancake.position[:, [0, 2]] for _, pancake, _ in rollouts.values()]
    drawn = np.concatenate([pans, *pancakes])
    margin = MARGIN + 0.8 * PAN_RADIUS
    low, high = drawn.min(axis=0) - margin, drawn.max(axis=0) + margin
    lowest = pans[:, 1].min() - MARGIN - 2.0 * PAN_RADIUS
    low[1] = max(low[1], lowest)  # a dropped pancake leaves the view
    height = 4.2 * (high[1] - low[1]) / (high[0] - low[0])
    figure = Figure(figsize=(4.2 * len(rollouts) + 0.6, height + 1.1), layout="compressed")
    row = figure.subplots(1, len(rollouts), squeeze=False)[0]
    for axes, (title, (pan, pancake, t_f)) in zip(row, rollouts.items(), strict=True):
        dress(axes)
        axes.set_title(title, fontsize=10, color=INK)
        axes.plot(pan.position[:, 0], pan.position[:, 2], color=STEEL, lw=0.9, ls=":", label="pan")
        pan_normals = rotations.matrix(pan.quat_xyzw)[:, :, 2]  # (T, 3)
        times = pancake.t if len(pancake.t) else pan.t[:: max(1, len(pan.t) // 20)]
        nearest = np.clip(np.searchsorted(pan.t, times), 0, len(pan.t) - 1)
        for k in nearest[_apart(pan.position[nearest], 0.02)]:
            _disc(axes, (pan.position[k], pan_normals[k]), PAN_RADIUS, (STEEL, STEEL), 0.45)
        if len(pancake.t):
            x, _, z = pancake.position.T
            axes.plot(x, z, color=BROWN, lw=0.7, ls=":", label="pancake")
            normals = body_normals(pancake, pan_normals[nearest[0]])
            for k in _apart(pancake.position, 0.025):
                pose = (pancake.position[k], normals[k])
                _disc(axes, pose, PANCAKE_RADIUS, (YELLOW, BROWN), 0.95)
            if t_f is not None:
                at = [np.interp(t_f, pancake.t, values) for values in (x, z)]
                axes.plot(*at, "o", ms=9, mfc="none", mec=GREEN, mew=1.4, label="$t_f$")
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x, outward [m]")
        axes.set_aspect("equal")
    row[0].set_ylabel("z, up [m]")
    shared_legend(figure, row, 3)
    return figure


def _apart(positions: np.ndarray, distance: float) -> list[int]:
    """Indices of positions (n, 3) farther than `distance` [m] from the previous selected one."""
    selected = [0]
    for k in range(len(positions)):
        if np.linalg.norm(positions[k] - positions[selected[-1]]) > distance:
            selected.append(k)
    return selected


def _disc(
    axes: Axes, pose: tuple[np.ndarray, ...], radius: float, colors: tuple[str, str], alpha: float
) -> None:
    """Draw a disc (centre, normal) edge-on; the normal is on the side of the first colour."""
    place, normal = pose
    n = normal[[0, 2]]
    along = np.array([n[1], -n[0]])
    centre = place[[0, 2]]
    for side, color in zip((0.002, -0.002), colors, strict=True):
        ends = np.stack([centre + side * n - radius * along, centre + side * n + radius * along])
        axes.plot(*ends.T, color=color, lw=1.5, alpha=alpha, solid_capstyle="butt")
    tip = centre + 0.05 * n
    axes.plot(*np.stack([centre, tip]).T, color=TOOL, lw=0.8, alpha=alpha)
    axes.plot(*tip, marker=".", ms=2.5, color=TOOL, alpha=alpha)
