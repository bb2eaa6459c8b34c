# SPDX-License-Identifier: Apache-2.0
"""Observation of a swing: where the ball came down onto the cup, and how it ended.

The ball hangs from the middle of the cup's floor, which is the origin of the tool. Its path has the
frame rate of the cameras; after a frame it is taken to fall freely as it did before it, until the
next: the string is slack then, and what the rim does to the ball comes later.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath

STRING = 0.40  # [m] from the cup's floor to the centre of the ball
RIM = 0.07  # [m] height of the rim above the floor
CUP_RADIUS = 0.05  # [m] inside
BALL_RADIUS = 0.018  # [m]
# Height above the floor at which a fall is measured [m]: there the ball has not touched the rim
# yet, which would throw it a few centimetres to one side or the other.
PLANE = RIM + BALL_RADIUS
GRAVITY = 9.81  # [m/s^2]
STEP = 0.001  # [s] in which the crossing is sought
GAP_MAX = 0.1  # [s] from the last but one frame before the ball comes down; beyond, it was not seen
END_TIME = 0.25  # [s] at the end of a rollout, in which the frames tell where the ball has ended


@dataclass(frozen=True)
class Swing:
    """What was observed of a swing."""

    apex: float  # largest height of the ball above `PLANE`, negative below it [m]
    t_c: float | None  # when it came down through this plane [s]; None if it never did
    miss: tuple[float, float] | None  # ball minus middle of the cup then, along x and y [m]
    caught: bool  # whether the ball is in the cup at the end

    @property
    def distance(self) -> float:
        """Horizontal distance at t_c [m]; infinite without a crossing."""
        return math.inf if self.miss is None else math.hypot(*self.miss)

    def to_json(self) -> dict[str, Any]:
        """As JSON data."""
        return asdict(self) | {"miss": None if self.miss is None else list(self.miss)}


def swing_of(seen: Mapping[str, Any]) -> Swing:
    """Swing from its JSON data."""
    miss = None if seen["miss"] is None else (float(seen["miss"][0]), float(seen["miss"][1]))
    return Swing(float(seen["apex"]), seen["t_c"], miss, bool(seen["caught"]))


def in_cup(position: np.ndarray) -> bool:
    """Whether a ball at a position (3,) in the frame of the cup [m] is in it."""
    x, y, z = position.tolist()
    return math.hypot(x, y) < CUP_RADIUS and 0.0 < z < RIM


def landing(relative: np.ndarray) -> int | None:
    """Row at which a ball comes down onto the cup; None if it never rises above `PLANE`.

    A large swing passes the plane beside the cup, and a ball may rise again from the rim: it is the
    first pass that touches the cup, or else the nearest one.

    Args:
        relative: Ball minus middle of the cup in `PLANE`, along the axes of the base [m].
            Shape (T, 3).
    """
    height = relative[:, 2]
    down = np.flatnonzero((height[:-1] > 0.0) & (height[1:] <= 0.0)) + 1
    if not len(down):
        return None
    beside = np.hypot(*relative[down, :2].T)
    touches = beside < CUP_RADIUS + 2.0 * BALL_RADIUS
    return int(down[touches.argmax() if touches.any() else beside.argmin()])


def observe_swing(cup: EndEffectorPath, ball: BodyPath) -> Swing | None:
    """Observe a swing; None if the ball was not seen when it came down, or at the end."""
    if len(ball.t) < 2 or cup.t[-1] - ball.t[-1] > END_TIME:
        return None
    t = np.arange(ball.t[0], ball.t[-1], STEP)
    last = np.maximum(np.searchsorted(ball.t, t, side="right") - 1, 1)  # frame before each time
    since, past = t - ball.t[last - 1], t - ball.t[last]
    share = (since / (ball.t[last] - ball.t[last - 1]))[:, np.newaxis]
    position = ball.position[last - 1] + share * (ball.position[last] - ball.position[last - 1])
    position[:, 2] -= 0.5 * GRAVITY * since * past
    relative = position - _interpolated(t, cup.t, cup.position)
    normals = rotations.matrix(cup.quat_xyzw)[:, :, 2]
    relative -= PLANE * _interpolated(t, cup.t, normals)
    height = relative[:, 2]
    t_c = miss = None
    if (k := landing(relative)) is not None:
        if since[k] > GAP_MAX:
            return None
        t_c, miss = float(t[k]), (float(relative[k, 0]), float(relative[k, 1]))
    end = ball.t >= cup.t[-1] - END_TIME
    ended = np.median(ball.position[end], axis=0) - cup.position[-1]
    caught = in_cup(rotations.matrix(cup.quat_xyzw[-1:])[0].T @ ended)
    return Swing(float(height.max()), t_c, miss, caught)


def _interpolated(t: np.ndarray, known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Linear interpolation of the columns of values (M, 3), known at (M,), at times t (T,)."""
    return np.stack([np.interp(t, known, column) for column in values.T], axis=1)
