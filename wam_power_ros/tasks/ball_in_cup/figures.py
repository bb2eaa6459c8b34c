# SPDX-License-Identifier: Apache-2.0
"""Figures of ball-in-a-cup: cup and ball from the side, and their heights over time."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.plotting import BLUE, GREEN, GREY, ORANGE, legend, side_by_side
from wam_power_ros.tasks.ball_in_cup.swing import RIM

CUP, BALL = BLUE, ORANGE


def side_view(cup: EndEffectorPath, ball: BodyPath, t_c: float | None = None) -> Figure:
    """A rollout seen from the side, and its heights over time.

    Args:
        cup: Path of the cup.
        ball: Path of the ball; may be empty.
        t_c: Time at which the ball came down through the plane of the rim [s], marked if given.
    """
    figure, (side, height) = side_by_side(8.6, 4.0, 1.0, 1.15)
    side.plot(cup.position[:, 0], cup.position[:, 2], color=CUP, lw=1.5, label="cup")
    height.plot(cup.t, cup.position[:, 2] + RIM, color=CUP, lw=1.5, label="rim of the cup")
    if len(ball.t):
        x, _, z = ball.position.T
        for time, *at in zip(ball.t, x, z, strict=True):  # the string
            origin = [np.interp(time, cup.t, cup.position[:, axis]) for axis in (0, 2)]
            side.plot([origin[0], at[0]], [origin[1], at[1]], color=GREY, lw=0.4)
        side.plot(x, z, "o-", ms=2.5, lw=0.8, color=BALL, label="ball")
        height.plot(ball.t, z, "o-", ms=2.5, lw=0.8, color=BALL, label="ball (camera)")
    if t_c is not None:
        height.axvline(t_c, color=GREEN, lw=0.8, ls=":", label="$t_c$")
    side.set_aspect("equal", adjustable="datalim")
    side.set(xlabel="x, outward [m]", ylabel="z, up [m]")
    height.set(xlabel="time [s]", ylabel="z, up [m]")
    legend(side)
    legend(height)
    return figure
