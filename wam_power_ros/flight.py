# SPDX-License-Identifier: Apache-2.0
"""Free flight of the pancake."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Flight:
    """What one toss did, as far as the motion capture frames tell. Every number is finite.

    Attributes:
        tossed: It rose above the pan by more than Delta_h.
        seen: The position at t_f is known. When False, `position` is the last one seen, its
            standard deviation is 1 m, and `landing_error` is 0.
        t_f: When it falls through pan height + Delta_h [s]; the path's end when never tossed.
        t_f_std: Standard deviation [s].
        position: At t_f, base frame [m]. Shape (3,).
        position_std: Standard deviation [m]. Shape (3,).
        pan_position: Of the pan at t_f, base frame [m]. Shape (3,).
        normal_start: v0, pancake normal at rest = pan normal at the start. Shape (3,).
        normal: v_tf, pancake normal at t_f. Shape (3,).
        normal_std: Standard deviation of its direction [rad].
        angle: Turned from rest to t_f about the spin axis, unfolded [rad]; 0 when never tossed.
        angle_std: Standard deviation [rad].
        spin_axis: Unit, base frame; `angle` is positive about it. Shape (3,).
        spin_rate: At t_f [rad/s].
        apex: Highest point above the pan's height at the start [m].
        landing_error: Pancake - pan at t_f, base frame [m]; the horizontal part matters.
            Shape (3,).
        resting: It lies flat in the pan at the path's end.
        flipped: It is seen at the path's end with its normal against the pan's.
        frames: Number of free-flight frames behind all this.
    """

    tossed: bool
    seen: bool
    t_f: float
    t_f_std: float
    position: np.ndarray
    position_std: np.ndarray
    pan_position: np.ndarray
    normal_start: np.ndarray
    normal: np.ndarray
    normal_std: float
    angle: float
    angle_std: float
    spin_axis: np.ndarray
    spin_rate: float
    apex: float
    landing_error: np.ndarray
    resting: bool
    flipped: bool
    frames: int
