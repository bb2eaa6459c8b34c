# SPDX-License-Identifier: Apache-2.0
"""Replay of a recorded joint movement: smoothing, sampling, and checks against the arm's limits."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy

from wam_power_ros.control.joint_references import Sampled, interpolated
from wam_power_ros.control.modes import ControllerError, Refusal
from wam_power_ros.control.safety import Limits
from wam_power_ros.learning.demonstration import smooth_joints

EASE_TIME = 0.3  # [s] in which a replay accelerates to its speed, and decelerates at the end
SPEED_MIN, SPEED_MAX = 0.01, 5.0  # bounds of the speed relative to the recording
KNOT_PERIOD = 0.01  # [s] between two postures of a movement
KNOTS_MIN = 4  # of a cubic spline


def movement(
    stamps_ns: Sequence[int] | np.ndarray, q: np.ndarray, speed: float
) -> tuple[np.ndarray, np.ndarray]:
    """Smooth a recording, and accelerate and decelerate it smoothly, from rest to rest.

    Args:
        stamps_ns: Header stamps [ns], strictly increasing. Shape (M,).
        q: Recorded joint angles [rad]. Shape (M, n).

    Returns:
        Times from 0 [s], shape (N,), and joint angles [rad], shape (N, n).

    Raises:
        ValueError: The speed is out of bounds, the stamps do not increase or have a gap, a value is
            not finite, or the recording is too short.
    """
    if not SPEED_MIN <= speed <= SPEED_MAX:
        raise ValueError(f"speed {speed} of a replay must be from {SPEED_MIN:g} to {SPEED_MAX:g}")
    t, smooth = smooth_joints(stamps_ns, q)
    duration = float(t[-1]) / speed
    ease = min(EASE_TIME, duration)
    times = np.linspace(0.0, duration + ease, math.ceil((duration + ease) / KNOT_PERIOD) + 1)

    def eased(elapsed: np.ndarray) -> np.ndarray:
        """Integral of a speed that rises smoothly from 0 to 1 within `ease`, then stays 1."""
        x = np.clip(elapsed / ease, 0.0, 1.0)
        return ease * (x**3 - 0.5 * x**4) + np.maximum(elapsed - ease, 0.0)

    half = 0.5 * (duration + ease)
    played = np.where(times < half, eased(times), duration - eased(duration + ease - times))
    return times, scipy.interpolate.CubicSpline(t, smooth)(np.clip(played * speed, 0.0, t[-1]))


def through(t: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Movement through waypoints from rest to rest, such as those of MoveIt.

    Args:
        t: Times of the waypoints, strictly increasing [s]. Shape (N,), N >= 1.
        q: Joint angles there [rad]. Shape (N, n).

    Returns:
        Times from 0 [s], shape (M,), and joint angles [rad], shape (M, n), M >= 4. A single
        waypoint is a posture to rest at.

    Raises:
        ValueError: The times do not increase.
    """
    if len(t) == 1:
        times = np.linspace(0.0, KNOT_PERIOD, KNOTS_MIN)
        return times, np.tile(q, (KNOTS_MIN, 1))
    spline = scipy.interpolate.CubicSpline(t - t[0], q, bc_type="clamped")
    duration = float(t[-1] - t[0])
    times = np.linspace(0.0, duration, max(math.ceil(duration / KNOT_PERIOD) + 1, KNOTS_MIN))
    return times, spline(times)


def sampled(t: npt.ArrayLike, q: npt.ArrayLike, period: float, limits: Limits) -> Sampled:
    """Sample a joint movement at the control period, and check it against the limits of the arm.

    Args:
        t: Times, increasing [s]. Shape (N,).
        q: Joint positions, smooth, because their second derivative is used [rad]. Shape (N, n).
        period: Sampling period of the joint states [s].

    Raises:
        ControllerError: The movement is not valid, has another number of joints, leaves the joint
            limits, or is too fast.
    """
    try:
        movement = interpolated(t, q, period)
    except (ValueError, TypeError) as error:
        raise ControllerError(Refusal.REFUSED, f"replay refused: {error}") from None
    n = len(limits.q_min)
    if movement.q.shape[1] != n:
        text = f"replay refused: {movement.q.shape[1]} joints, the arm has {n}"
        raise ControllerError(Refusal.REFUSED, text)
    if np.any(movement.q < limits.q_min) or np.any(movement.q > limits.q_max):
        text = "replay refused: the movement leaves the joint limits"
        raise ControllerError(Refusal.REFUSED, text)
    share = float(np.max(np.abs(movement.qd) / limits.qd_max))
    if share > 1.0:
        text = f"replay refused: the movement reaches {share:.2f} times a joint-speed limit"
        raise ControllerError(Refusal.TOO_FAST, text, round(1.0 / share, 3))
    return movement
