# SPDX-License-Identifier: Apache-2.0
"""Figure of takes: joint angles and speeds, with the limits of the arm if within view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.figure import Figure

from wam_power_ros.plotting import CYCLE, STEEL, dress, shared_legend

Limits = tuple[np.ndarray, np.ndarray, np.ndarray]  # lowest, highest [rad], fastest [rad/s]


def joints(
    movements: Mapping[str, tuple[np.ndarray, np.ndarray]],
    joint_names: Sequence[str],
    limits: Limits | None,
) -> Figure:
    """Joint angles and speeds over time, a row for each joint.

    Args:
        movements: Name -> times [s] (N,) and smooth joint angles [rad] (N, n).
        joint_names: Names of the joints.
        limits: Limits of the arm, drawn dashed, if known.
    """
    count = len(joint_names)
    figure = Figure(figsize=(9.4, 1.3 * count + 0.9), layout="constrained")
    grid = figure.subplots(count, 2, squeeze=False, sharex=True)
    for joint, (name, (angle, speed)) in enumerate(zip(joint_names, grid, strict=True)):
        for axes in (angle, speed):
            dress(axes)
        for color, (label, (t, q)) in zip(cycle(CYCLE), movements.items(), strict=False):
            angle.plot(t, q[:, joint], color=color, lw=1.4, label=label)
            speed.plot(t, np.gradient(q[:, joint], t), color=color, lw=1.4)
        angle.set_ylabel(f"{name} [rad]")
        if limits is not None:
            low, high, fastest = (values[joint] for values in limits)
            for axes, values in ((angle, (low, high)), (speed, (-fastest, fastest))):
                for value in values:  # outside the view if far away
                    bottom, top = axes.get_ylim()
                    axes.axhline(value, color=STEEL, lw=0.9, ls="--", label="limit")
                    axes.set_ylim(bottom, top)
    grid[0, 0].set_title("angle", fontsize=10)
    grid[0, 1].set_title("speed [rad/s]", fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    shared_legend(figure, [grid[0, 0]], 3)
    return figure
