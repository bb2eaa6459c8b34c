# SPDX-License-Identifier: Apache-2.0
"""Movement in which an arm measures itself: postures reached from both sides, then two sweeps.

At each posture the arm comes to rest twice, from below and from above, so that the mean torque of
both is without friction. The sweeps move all joints at once, slowly and as fast as the limits of a
person beside the arm allow.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.joint_references import MinJerk
from wam_power_ros.control.safety import Limits, plane_fault

KNOT = 0.02  # [s] between two samples of the movement
APPROACH = 0.06  # [rad] by which each joint comes from below, then from above
MOVE_SPEED, APPROACH_SPEED = 0.5, 0.1  # [rad/s] peak
MOVE_ACCELERATION = 1.0  # [rad/s^2] peak: a short move must not be a jerk
CARRIED_SHARE = 0.6  # of the torque limits that gravity may need at a posture
REST = 0.6  # [s] at a posture, from each side
ELBOW_SPEED, TOOL_SPEED = 0.75, 1.1  # [m/s] of guarded points and tool, at most
LIMIT_SHARE = 0.8  # of the arm's own speed limits, if they are lower
RANGE = np.deg2rad(40.0)  # [rad] of each joint about home
SWEEP_RANGE = np.deg2rad(30.0)
HARMONICS = 4
SLOW = 0.3  # speed of the slow sweep, relative to the faster one
MARGIN = 0.1  # [rad] from a position limit
_DRAWS = 2000  # of a posture, before none is taken to exist


@dataclass(frozen=True, eq=False)
class Excitation:
    """A joint movement and what it contains.

    Rests 2 k and 2 k + 1 are at posture k, from below and from above.
    """

    t: np.ndarray  # from 0 [s] (T,)
    q: np.ndarray  # [rad] (T, n)
    rests: np.ndarray  # begin and end of each [s] (R, 2)
    sweeps: np.ndarray  # begin and end of each [s] (S, 2)


def excitation(
    arm: Arm,
    limits: Limits,
    home: np.ndarray,
    rng: np.random.Generator,
    postures: int = 22,
    seconds: tuple[float, ...] = (30.0, 20.0, 15.0, 10.0),
) -> Excitation:
    """Plan the movement from rest at home (n,) [rad] to rest at home; the arm's buffers are used.

    It has a number of postures, and sweeps of these durations [s], a slow and a faster one in turn.

    Raises:
        ValueError: No posture around home keeps the limits.
    """
    rows, rests, sweeps = [home[None]], [], []
    length = 1  # rows so far

    def add(part: np.ndarray) -> tuple[float, float]:
        nonlocal length
        rows.append(part)
        begun, length = length, length + len(part)
        return (begun - 1) * KNOT, (length - 1) * KNOT

    def move(goal: np.ndarray, speed: float) -> None:
        add(_move(arm, limits, rows[-1][-1], goal, speed))

    for posture in _postures(arm, limits, home, rng, postures):
        for side in (-APPROACH, APPROACH):
            move(posture + side, MOVE_SPEED)
            move(posture, APPROACH_SPEED)
            rests.append(add(np.tile(posture, (round(REST / KNOT), 1))))
    # Sweeps need room on both sides, which a home near a limit has not.
    low, high = _range(limits)
    room = np.minimum(SWEEP_RANGE, 0.5 * (high - low))
    centre = np.minimum(np.maximum(home, low + room), high - room)
    move(centre, MOVE_SPEED)
    for duration, share in zip(seconds, itertools.cycle((SLOW, 1.0))):
        add(np.tile(centre, (round(0.2 / KNOT), 1)))
        sweeps.append(add(_sweep(arm, limits, centre, room, rng, duration, share)))
    move(home, MOVE_SPEED)
    q = np.concatenate(rows)
    return Excitation(np.arange(len(q)) * KNOT, q, np.array(rests), np.array(sweeps))


def _move(
    arm: Arm, limits: Limits, start: np.ndarray, goal: np.ndarray, speed: float
) -> np.ndarray:
    """Samples of a move, slowed down until the arm keeps its speeds. Shape (T, n)."""
    distance = float(np.abs(goal - start).max())
    if not distance:
        return np.empty((0, arm.n))
    speed = min(speed, 0.78 * math.sqrt(distance * MOVE_ACCELERATION))  # of a minimum jerk
    while True:
        path = MinJerk(start, goal, speed)
        count = max(2, round(path.duration / KNOT))
        states = [path.at(path.duration * k / count) for k in range(1, count + 1)]
        peak = _relative_speed(arm, limits, [(q, qd) for q, qd, _ in states])
        if peak <= 1.0:
            return np.array([q for q, _, _ in states])
        speed /= 1.02 * peak


def _relative_speed(arm: Arm, limits: Limits, states: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Largest speed of guarded points, tool and joints over its limit."""
    elbow_max = min(ELBOW_SPEED, LIMIT_SHARE * limits.guarded_speed)
    tool_max = min(TOOL_SPEED, LIMIT_SHARE * limits.tool_speed)
    joint_max = LIMIT_SHARE * limits.qd_max
    peak = 0.0
    for q, qd in states:
        guarded, tool = arm.speeds(q, qd)
        joint = float((np.abs(qd) / joint_max).max())
        peak = max(peak, joint, tool / tool_max, *(speed / elbow_max for speed in guarded))
    return peak


def _range(limits: Limits) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest positions of a posture [rad]. Shapes (n,)."""
    reach = APPROACH + MARGIN
    return limits.q_min + reach, limits.q_max - reach


def _allowed(arm: Arm, limits: Limits, q: np.ndarray) -> bool:
    """Whether joints, tool and guarded points are in their ranges, and gravity is carried."""
    low, high = _range(limits)
    if np.any(q < low) or np.any(q > high):
        return False
    if np.any(np.abs(arm.gravity(q)) > CARRIED_SHARE * limits.torque):
        return False
    motion = arm.motion(q, np.zeros(arm.n))
    position = motion.position
    if np.any(position < limits.workspace_min) or np.any(position > limits.workspace_max):
        return False
    points = dict(zip(arm.guarded, motion.guarded_positions, strict=True))
    return plane_fault({**points, "tool": position.tolist()}, limits) is None


def _postures(
    arm: Arm, limits: Limits, home: np.ndarray, rng: np.random.Generator, count: int
) -> list[np.ndarray]:
    """Allowed postures, in an order that makes the way short. Shapes (n,)."""
    found: list[np.ndarray] = []
    low, high = _range(limits)
    for _ in range(_DRAWS):
        q = home + RANGE * rng.uniform(-1.0, 1.0, arm.n)
        q = np.minimum(np.maximum(q, low), high)
        if _allowed(arm, limits, q):
            found.append(q)
        if len(found) == count:
            break
    else:
        raise ValueError(
            f"only {len(found)} of {count} postures within {np.rad2deg(RANGE):.0f} degrees of home "
            "keep the limits of the arm: check home, workspace and plane"
        )
    ordered, here = [], home
    while found:
        nearest = int(np.argmin([np.abs(q - here).max() for q in found]))
        here = found.pop(nearest)
        ordered.append(here)
    return ordered


def _sweep(
    arm: Arm,
    limits: Limits,
    centre: np.ndarray,
    room: np.ndarray,
    rng: np.random.Generator,
    seconds: float,
    share: float,
) -> np.ndarray:
    """Sum of harmonics in every joint, from rest to rest at the centre. Shape (T, n)."""
    for _ in range(_DRAWS):
        phase = rng.uniform(0.0, 2.0 * np.pi, (HARMONICS, arm.n))
        size = rng.uniform(0.5, 1.0, (HARMONICS, arm.n))
        period = 10.0  # [s], then stretched to the speed that is allowed
        fine = _wave(np.linspace(0.0, 4.0, 2000), phase, size)
        scale = 0.99 * room / np.abs(fine).max(axis=0)
        q = centre + scale * fine
        if all(_allowed(arm, limits, each) for each in q[::10]):
            speed = np.gradient(q, 4.0 * period / 2000, axis=0)
            states = list(zip(q[::4], speed[::4], strict=True))
            period *= _relative_speed(arm, limits, states) / share
            t = np.arange(round(seconds / KNOT) + 1) * KNOT
            return centre + scale * _wave(t / period, phase, size)
    raise ValueError("no sweep near home keeps the limits: check home, workspace and plane")


def _wave(s: np.ndarray, phase: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Harmonics of one period, which begin and end at zero. Shape (T, n).

    `s` (T,) counts periods since the beginning; `phase` [rad] and `size` (H, n) are those of the
    harmonics in each joint, before the higher ones are made smaller.
    """
    number = np.arange(1, len(size) + 1)
    angle = 2.0 * np.pi * number * s[:, None]  # (T, H)
    wave = np.einsum("hn,thn->tn", size / number[:, None], np.sin(angle[:, :, None] + phase))
    ease = np.clip(np.minimum(s, s[-1] - s) / 0.5, 0.0, 1.0)
    return wave * (ease**3 * (10.0 - 15.0 * ease + 6.0 * ease**2))[:, None]
