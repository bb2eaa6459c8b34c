# SPDX-License-Identifier: Apache-2.0
"""Heading of a movement: the direction in which a movement in one vertical plane goes.

A task whose movement is planar is written for the x-z plane. It sees its rollouts, and learns the
policy, in axes that are turned about the vertical by the heading of the demonstration, which may go
in any direction, towards the base too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout

P = TypeVar("P", EndEffectorPath, BodyPath)
STEP = math.radians(5.0)  # to which a heading is rounded: a hand is no more accurate
LEAN_MAX = math.radians(20.0)  # of the axis about which a tool turns, from the horizontal
ACROSS_MAX = 0.4  # mean speed across the plane of a movement, relative to that along it
APART_MAX = math.radians(30.0)  # of one demonstration from the heading of all
STROKE = 0.3  # share of the highest speed along the plane that a stroke has


def heading(
    demonstrations: Sequence[Demonstration], forward: Callable[[Demonstration], np.ndarray]
) -> float:
    """Common heading of demonstrations, by the direction (3,) that is `forward` in each [rad].

    Raises:
        ValueError: They go in different directions, or one in no vertical plane.
    """
    ways = np.array([forward(each)[:2] for each in demonstrations]).reshape(-1, 2)
    x, y = ways.sum(axis=0)
    angles = np.arctan2(ways[:, 1] * x - ways[:, 0] * y, ways @ [x, y])  # from that of all
    if (np.abs(angles) > APART_MAX).any():
        own = [f"{math.degrees(math.atan2(v, u)):.0f}" for u, v in ways]
        raise ValueError(
            f"the demonstrations go in directions of {', '.join(own)} degrees about the vertical, "
            f"more than {math.degrees(APART_MAX):.0f} apart: teach them alike, or one a session"
        )
    return STEP * round(math.atan2(y, x) / STEP) + 0.0


def forward_of_turn(demonstration: Demonstration) -> np.ndarray:
    """Horizontal unit vector (3,) of a tool whose front edge goes up where it turns fastest.

    It is x for a tool that does not turn.

    Raises:
        ValueError: The axis about which it turns is not level.
    """
    turns = rotations.matrix(demonstration.quat_xyzw)
    omega = rotations.log(turns[1:] @ np.swapaxes(turns[:-1], 1, 2))  # (N-1, 3) a period
    axis = (omega * np.linalg.norm(omega, axis=1, keepdims=True)).sum(axis=0)
    if not axis.any():
        return np.array([1.0, 0.0, 0.0])
    lean = math.atan2(abs(axis[2]), math.hypot(axis[0], axis[1]))
    if not lean <= LEAN_MAX:
        raise ValueError(
            f"the tool turns about an axis {math.degrees(lean):.0f} degrees from the horizontal, "
            f"at most {math.degrees(LEAN_MAX):.0f} can be learnt"
        )
    forward = np.array([-axis[1], axis[0], 0.0])
    return forward / np.linalg.norm(forward)


def forward_of_stroke(demonstration: Demonstration) -> np.ndarray:
    """Horizontal unit vector (3,) from which the last stroke of a movement comes.

    Raises:
        ValueError: The movement is in no vertical plane.
    """
    velocity = demonstration.velocity[:, :2]
    squares, axes = np.linalg.eigh(velocity.T @ velocity)
    across = math.sqrt(max(squares[0], 0.0) / max(squares[1], 1e-12))
    if across > ACROSS_MAX:
        raise ValueError(
            f"the movement goes across its plane at {across:.0%} of the speed along it, "
            f"at most {ACROSS_MAX:.0%} can be learnt"
        )
    along = velocity @ axes[:, 1]
    last = np.flatnonzero(np.abs(along) > STROKE * np.abs(along).max())[-1:]
    return np.append(axes[:, 1], 0.0) * -np.sign(along[last].sum())


def turned(rollout: Rollout, heading: float) -> Rollout:
    """Rollout in axes that are turned about the vertical by a heading [rad]."""
    if heading == 0.0:
        return rollout
    seen = (rollout.body, rollout.before)
    body, before = (None if path is None else turned_path(path, heading) for path in seen)
    return replace(rollout, tool=turned_path(rollout.tool, heading), body=body, before=before)


def turned_path(path: P, heading: float) -> P:
    """Path in axes that are turned about the vertical by a heading [rad]."""
    if heading == 0.0:
        return path
    back = np.array([0.0, 0.0, -heading])
    position = path.position @ rotations.exp(back).T
    quat_xyzw = rotations.multiply(
        np.broadcast_to(rotations.quat_of_vector(back), path.quat_xyzw.shape), path.quat_xyzw
    )
    return replace(path, position=position, quat_xyzw=quat_xyzw)
