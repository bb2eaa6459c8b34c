# SPDX-License-Identifier: Apache-2.0
"""Replaying a recorded joint movement: what the arm is given to follow."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from wam_power_ros.learning.demonstration import smooth_joints

EASE = 0.3  # [s] in which a replay comes to its speed, and out of it
KNOT = 0.01  # [s] between two postures of a replay


def movement(
    stamps_ns: Sequence[int] | np.ndarray, q: np.ndarray, speed: float
) -> tuple[np.ndarray, np.ndarray]:
    """A recording as a movement from rest to rest that torques can follow: smooth, and eased.

    Args:
        stamps_ns: Header stamps [ns], strictly increasing. Shape (M,).
        q: Joint angles as recorded [rad]. Shape (M, n).
        speed: 1 for as recorded.

    Returns:
        Times from 0 [s], shape (N,), and joint angles [rad], shape (N, n).

    Raises:
        ValueError: A speed that is not positive, stamps that do not increase, a gap, a value that
            is not finite, a recording too short.
    """
    if not 0.0 < speed < math.inf:
        raise ValueError(f"speed {speed} must be positive")
    t, smooth = smooth_joints(stamps_ns, q)
    whole = float(t[-1]) / speed
    ease = min(EASE, whole)
    times = np.linspace(0.0, whole + ease, math.ceil((whole + ease) / KNOT) + 1)

    def eased(since: np.ndarray) -> np.ndarray:
        """Integral of a speed that rises smoothly from 0 to 1 within `ease`, and stays."""
        x = np.clip(since / ease, 0.0, 1.0)
        return ease * (x**3 - 0.5 * x**4) + np.maximum(since - ease, 0.0)

    half = 0.5 * (whole + ease)
    done = np.where(times < half, eased(times), whole - eased(whole + ease - times))
    return times, CubicSpline(t, smooth)(np.clip(done * speed, 0.0, t[-1]))
