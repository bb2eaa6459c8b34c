# SPDX-License-Identifier: Apache-2.0
"""Ballistic fit with drag to the frames of a flight: release, apex and crossing of a height.

    p(t) = p0 + v s + (g + a) s^2/2 + j s^3/6 + c w(s),   s = t - origin

w is the double integral of -|v| v along the drag-free parabola and c the drag coefficient of a disc
at an average attitude; a and j, both small, model the true attitude and air draughts. p0, v, a and
j are fitted to all frames by robust weighted least squares, with covariance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.tasks.flip.frames import POSITION_NOISE, Frames, interpolate, pan_normal

HUBER_THRESHOLD = 2.5  # residual above which a frame is weighted less [standard deviations]
GRAVITY = 9.81  # [m/s^2]
_DRAG = 0.3  # drag coefficient c in xdd = g - c |v| v at an average attitude [1/m]
_ACCELERATION_STD = 0.5  # prior of a, the effect of attitude and draughts at mid-flight [m/s^2]
_JERK_STD = 5.0  # prior of j, its rate of change [m/s^3]
_INLIER_DISTANCE = 0.025  # largest distance of an inlier from a drag-free parabola [m]
_RELEASE_HEIGHT = 0.01  # height of the centre above the pan's floor up to which both touch [m]
_GRID_STEP = 0.001  # [s]
_DRAG_GRID_STEP = 0.002  # [s]


@dataclass(frozen=True, eq=False)
class Arc:
    """Fitted path of the pancake's centre."""

    t: np.ndarray  # times of the inlier frames [s], shape (m,)
    used: np.ndarray  # indices of the inlier frames, shape (m,)
    origin: float  # their mean time, s = 0 [s]
    theta: np.ndarray  # p0 [m], v [m/s], a [m/s^2], j [m/s^3], shape (12,)
    covariance: np.ndarray  # of theta, shape (12, 12)
    drag_velocity: np.ndarray  # at the origin, of the parabola along which w is integrated [m/s]

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position at times t (m,) [s], base frame [m]. Shape (m, 3)."""
        s = np.atleast_1d(t) - self.origin
        return _powers(s) @ self.theta + _fall(s) + _drag(s, self.drag_velocity)


@dataclass(frozen=True, eq=False)
class Crossing:
    """Downward crossing of a height above the pan."""

    t: float  # [s]
    position: np.ndarray  # at t, base frame [m], shape (3,)
    position_std: float  # largest standard deviation of it along an axis [m]
    apex: float  # largest height of the arc, base frame [m]


def fit_arc(frames: Frames) -> Arc | None:
    """Fit an arc to the frames of the flight by robust weighted least squares.

    None with fewer than two frames in flight, or without a frame at rest before.
    """
    run = frames.flight()
    if len(run) < 2:
        return None
    used = run[_consensus(frames.t[run], frames.position[run])]
    t, position = frames.t[used], frames.position[used]
    origin = float(t.mean())
    s = t - origin
    target = position - _fall(s)
    velocity = np.polyfit(s, target, 1)[0]
    design = _powers(s)  # (m, 3, 12)
    prior = np.diag(np.repeat([0.0, 0.0, _ACCELERATION_STD**-2, _JERK_STD**-2], 3))
    weights = np.ones(len(t))
    for _ in range(8):
        drag = _drag(s, velocity)
        scale = weights / POSITION_NOISE**2
        information = np.einsum("m,mij,mik->jk", scale, design, design) + prior
        covariance = np.linalg.inv(information)
        theta = covariance @ np.einsum("m,mij,mi->j", scale, design, target - drag)
        distance = np.linalg.norm(target - drag - design @ theta, axis=1)
        residual = distance / POSITION_NOISE
        weights = np.minimum(1.0, HUBER_THRESHOLD / np.maximum(residual, 1e-9))
        velocity = theta[3:6]
    # If the frames scatter more than POSITION_NOISE, the covariance is scaled up accordingly.
    freedom = 3 * len(t) - 12
    if freedom > 0:
        excess = float(np.sum(weights * residual**2)) / freedom
        covariance = covariance * max(1.0, excess)
    return Arc(t, used, origin, theta, covariance, velocity)


def find_crossing(arc: Arc, pan: EndEffectorPath, delta_h: float) -> Crossing | None:
    """Find the first downward crossing of a height above the pan after the apex.

    The arc is evaluated from 0.1 s before its frames to 0.5 s after them; None if it stays below or
    above the height.
    """
    start = max(arc.t[0] - 0.1, pan.t[0])
    end = min(arc.t[-1] + 0.5, pan.t[-1])
    grid = start + _GRID_STEP * np.arange(max(int((end - start) / _GRID_STEP), 1) + 1)
    height = arc.position(grid)[:, 2]
    above = height - np.interp(grid, pan.t, pan.position[:, 2]) - delta_h
    if above.max() <= 0.0:
        return None
    apex = int(np.argmax(height))
    if above[apex] <= 0.0:
        apex = int(np.argmax(above))
    below = np.flatnonzero(above[apex:] <= 0.0)
    if len(below) == 0:
        return None
    k = apex + int(below[0])
    slope = float((above[k] - above[k - 1]) / (grid[k] - grid[k - 1]))
    t = float(grid[k] - above[k] / slope)
    return Crossing(t, *_at_crossing(arc, t, slope), float(height.max()))


def release_time(frames: Frames, arc: Arc, pan: EndEffectorPath) -> float:
    """Time of release [s]: the last time at which the arc of `frames` is at the pan's floor."""
    before = frames.t[: arc.used[0]][~frames.flying[: arc.used[0]]]
    earliest = float(before[-1]) if len(before) else float(pan.t[0])
    count = max(int((arc.t[0] - earliest) / _GRID_STEP), 1)
    times = np.linspace(earliest, arc.t[0], count + 1)
    offset = arc.position(times) - interpolate(times, pan.t, pan.position)
    height = np.sum(offset * pan_normal(pan, times), axis=1)
    low = np.flatnonzero(height < _RELEASE_HEIGHT)
    return float(times[low[-1]]) if len(low) else earliest


def _consensus(t: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Inliers of the best parabola through two of the frames (consensus). Shape (m,), bool."""
    lifted = position + 0.5 * GRAVITY * np.outer(t**2, [0.0, 0.0, 1.0])  # straight lines
    picks = np.unique(np.linspace(0, len(t) - 1, min(len(t), 25)).round().astype(int))
    first, second = (picks[index] for index in np.triu_indices(len(picks), 1))
    slope = (lifted[second] - lifted[first]) / (t[second] - t[first])[:, None]
    line = lifted[first][:, None] + (t[None] - t[first][:, None])[:, :, None] * slope[:, None]
    distance = np.linalg.norm(line - lifted[None], axis=2)  # (pairs, m)
    near = distance < _INLIER_DISTANCE
    score = near.sum(axis=1) - np.minimum(distance, _INLIER_DISTANCE).mean(axis=1)
    return near[int(np.argmax(score))]


def _at_crossing(arc: Arc, t: float, slope: float) -> tuple[np.ndarray, float]:
    """Position at t and its largest standard deviation; the crossing time depends on the fit.

    `slope` is the rate of change of the height above the pan at t [m/s].
    """
    step = 1e-4
    before, now, after = arc.position(t + step * np.array([-1.0, 0.0, 1.0]))
    velocity = (after - before) / (2.0 * step)
    jacobian = _powers(np.array([t - arc.origin]))[0]  # (3, 12)
    dt = -jacobian[2] / slope  # (12,)
    moved = jacobian + np.outer(velocity, dt)
    variance = np.einsum("ij,jk,ik->i", moved, arc.covariance, moved) + POSITION_NOISE**2
    return now, math.sqrt(variance.max())


def _powers(s: np.ndarray) -> np.ndarray:
    """Design matrix of p0 + v s + a s^2/2 + j s^3/6. Shape (m, 3, 12)."""
    powers = np.stack([np.ones_like(s), s, s**2 / 2.0, s**3 / 6.0], axis=1)  # (m, 4)
    return np.einsum("mk,ij->mikj", powers, np.eye(3)).reshape(-1, 3, 12)


def _fall(s: np.ndarray) -> np.ndarray:
    """Free fall g s^2/2 [m]. Shape (m, 3)."""
    return np.outer(-0.5 * GRAVITY * s * s, [0.0, 0.0, 1.0])


def _drag(s: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Double integral c w(s) of -c |v| v from s = 0 along a parabola [m]. Shape (m, 3)."""
    low, high = min(float(s.min()), 0.0) - _GRID_STEP, max(float(s.max()), 0.0) + _GRID_STEP
    grid = np.linspace(low, high, max(int((high - low) / _DRAG_GRID_STEP), 8))
    v = velocity + np.outer(grid, [0.0, 0.0, -GRAVITY])
    rate = _integral(-_DRAG * np.linalg.norm(v, axis=1, keepdims=True) * v, grid)
    return interpolate(s, grid, _integral(rate, grid))


def _integral(values: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Running trapezium integral from s = 0. Shape (m, 3)."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(grid)[:, None]
    total = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    return total - interpolate(np.zeros(1), grid, total)
