# SPDX-License-Identifier: Apache-2.0
"""Putting the ball back without a hand: empty the cup, then still the swinging ball.

The cup is emptied by rolling the last joint over and back. The ball is stilled by stepping the cup
towards it when it is farthest out, and back half a period later: a step s that is fast beside the
swing leaves the ball behind by s, so the two take 2 s off the amplitude.
"""

from __future__ import annotations

import math

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.demonstration import ToolPose
from wam_power_ros.tasks.ball_in_cup.swing import GRAVITY
from wam_power_ros.tasks.reset import Move

ROLL, ROLL_TIME = 2.8, 2.1  # of the last joint [rad], there and back again [s each]
STEP_MAX, STEP_TIME = 0.08, 0.5  # [m], [s] of a step of the cup
STEP_SHARE = 0.85  # part of a step by which it leaves the ball behind [1]
REQUEST_TIME = 0.15  # [s] from a request until the arm has begun the movement
VELOCITY_LAG = 0.05  # [s] of a tracked velocity
KNOT = 0.02  # [s] between two postures of a movement
NUDGE = 1e-4  # [rad] by which a joint is turned to see what that does to the tool


def empty_cup(q_start: np.ndarray) -> Move:
    """Roll the cup over and back. Shape of `q_start` (n,) [rad]."""
    t = np.arange(0.0, 2.0 * ROLL_TIME + KNOT, KNOT)
    q = np.tile(q_start, (len(t), 1))
    side = -1.0 if q_start[-1] > 0.0 else 1.0  # where the joint has more room
    q[:, -1] += side * ROLL * (_rise(t / ROLL_TIME) - _rise(t / ROLL_TIME - 1.0))
    return Move(t, q)


def swing_rate(string: float) -> float:
    """Rate of a small swing on a string [m], in rad/s."""
    return math.sqrt(GRAVITY / string)


def swing_phasor(beside: np.ndarray, velocity: np.ndarray, rate: float) -> np.ndarray:
    """Swing as complex numbers a, with a ball at Re(a exp(i w t)) from where it hangs [m].

    Args:
        beside: Ball from where it hangs, along x and y [m]. Shape (2,).
        velocity: Its tracked velocity, `VELOCITY_LAG` old [m/s]. Shape (2,).
        rate: w, see `swing_rate` [rad/s].
    """
    turned = rate * VELOCITY_LAG
    velocity = (velocity - rate * math.sin(turned) * beside) / math.cos(turned)
    return beside - 1j * velocity / rate


def damp_swing(arm: ToolPose, q_start: np.ndarray, swing: np.ndarray, rate: float) -> Move:
    """Step the cup along x and y so that a swing is stilled, as far as `STEP_MAX` allows.

    Args:
        arm: Kinematics of the arm, at rest at `q_start`.
        q_start: Posture in which the ball hangs below the cup [rad]. Shape (n,).
        swing: See `swing_phasor`. Shape (2,).
        rate: See `swing_rate` [rad/s].
    """
    half_period = math.pi / rate
    lead = REQUEST_TIME + 0.5 * STEP_TIME  # the middle of the first step is not earlier
    t = np.arange(0.0, 2.0 * half_period + STEP_TIME + KNOT, KNOT)
    q = np.tile(q_start, (len(t), 1))
    joints = _joints_of_steps(arm, q_start)
    for amplitude, turn in zip(swing, joints, strict=True):
        phase = -float(np.angle(amplitude)) - rate * lead  # until it is farthest along +
        waits = (phase % math.pi) / rate  # until it is farthest on either side
        side = 1.0 if (phase % (2.0 * math.pi)) < math.pi else -1.0
        step = side * min(float(abs(amplitude)) / (2.0 * STEP_SHARE), STEP_MAX)
        course = _rise((t - waits) / STEP_TIME) - _rise((t - waits - half_period) / STEP_TIME)
        q += step * course[:, np.newaxis] * turn
    return Move(t, q)


def _rise(s: np.ndarray) -> np.ndarray:
    """Minimum-jerk rise from 0 to 1."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 + s * (-15.0 + 6.0 * s))


def _joints_of_steps(arm: ToolPose, q: np.ndarray) -> np.ndarray:
    """Joint displacements per metre of the tool along x, and along y, without a turn. (2, n)."""
    position, rotation = arm.tool_pose(q)
    columns = []
    for nudge in NUDGE * np.eye(len(q)):
        moved, turned = arm.tool_pose(q + nudge)
        columns.append(np.concatenate([moved - position, rotations.log(turned @ rotation.T)]))
    return np.linalg.pinv(np.array(columns).T / NUDGE)[:, :2].T
