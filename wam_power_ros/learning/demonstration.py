# SPDX-License-Identifier: Apache-2.0
"""A demonstration: joint samples of a hand-guided arm -> a smooth movement on the control grid."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.policy import read_only

PERIOD = 0.002  # [s] of the control loop
CUTOFF = 12.0  # [Hz] the hand does nothing faster; encoders and differentiation do
GAP_MAX = 0.05  # [s] a straight line over more than this is no longer what the hand did
TRIM_START = 0.15  # of the peak speed: a slow beginning is left out, the toss is fitted finer
TRIM_END = 0.05  # of the peak speed: following under the pancake and cushioning it are kept
PAUSE_MAX = 0.25  # [s] a turning point is slow for less than this; a longer pause ends a movement


class ToolPose(Protocol):
    """What is needed of an arm model."""

    n: int

    def tool_pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and rotation matrix (3, 3) of the tool frame in the base frame."""


@dataclass(frozen=True, eq=False)
class Demonstration:
    """A movement sampled at a constant period; arrays are read-only.

    Attributes:
        t: From 0 [s]. Shape (N,).
        q: Joint angles [rad]. Shape (N, nj).
        position: Of the tool frame in the base frame [m]. Shape (N, 3).
        velocity: [m/s]. Shape (N, 3).
        acceleration: [m/s^2]. Shape (N, 3).
        quat_xyzw: Orientation of the tool frame, unit. Shape (N, 4).
        rotation_vector: r with R(t) = exp(r(t)) R(0), continuous, from 0 [rad]. Shape (N, 3).
        period: Of the samples [s].

    Raises:
        ValueError: A shape, a non-finite value or fewer than three samples.
    """

    t: np.ndarray
    q: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    quat_xyzw: np.ndarray
    rotation_vector: np.ndarray
    period: float

    def __post_init__(self) -> None:
        count = np.size(self.t)
        if count < 3:
            raise ValueError(f"a demonstration of {count} samples; at least 3 are needed")
        joints = np.shape(self.q)[-1] if np.ndim(self.q) == 2 else 1
        for name, shape in (
            ("t", (count,)),
            ("q", (count, joints)),
            ("position", (count, 3)),
            ("velocity", (count, 3)),
            ("acceleration", (count, 3)),
            ("quat_xyzw", (count, 4)),
            ("rotation_vector", (count, 3)),
        ):
            object.__setattr__(self, name, read_only(name, getattr(self, name), shape))

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.t[-1])


def from_joint_samples(
    arm: ToolPose,
    stamps_ns: Sequence[int] | np.ndarray,
    q: np.ndarray,
    *,
    period: float = PERIOD,
    cutoff: float = CUTOFF,
    gap_max: float = GAP_MAX,
    trim: bool = True,
    trim_start: float = TRIM_START,
    trim_end: float = TRIM_END,
) -> Demonstration:
    """Resample on the device's own stamps, smooth without delay, differentiate, trim.

    The grid is the whole multiples of the period, and every step is local in time. The trimmed
    movement is therefore the same, bit for bit, however long the arm rested before or after.

    Args:
        arm: For its forward kinematics.
        stamps_ns: Header stamps [ns], strictly increasing. Shape (M,).
        q: Joint angles [rad]. Shape (M, arm.n).
        period: Of the result [s].
        cutoff: -3 dB of the smoothing [Hz] (cubic Savitzky-Golay, zero phase).
        gap_max: Longest time between samples [s].
        trim: Keep only the movement around the peak speed of the tool; slower than a share of
            that peak for longer than PAUSE_MAX is no part of it.
        trim_start: That share before the peak, in (0, 1).
        trim_end: That share after the peak, in (0, 1).

    Raises:
        ValueError: Stamps that do not increase, a gap, a value that is not finite, a wrong shape,
            a recording too short, or no movement in it.
    """
    stamps = _checked_stamps(stamps_ns, gap_max)
    q = read_only("q", q, (len(stamps), arm.n))
    q = _resampled(stamps, q, round(period * 1e9))  # (N, nj)
    half = _half_window(period, cutoff)
    window = 2 * half + 1
    if len(q) < window:
        raise ValueError(
            f"recording of {len(q)} samples at {period} s; smoothing needs at least {window}"
        )
    poses = [arm.tool_pose(row) for row in q]
    position = np.array([pose[0] for pose in poses])
    matrix = np.array([pose[1] for pose in poses])
    first, last = 0, len(q) - 1
    if trim:
        velocity = _smoothed(position, window, 1, period)
        first, last = _movement(np.linalg.norm(velocity, axis=1), trim_start, trim_end, period)
    # Smoothing sees half a window beyond the movement and nothing farther away.
    start = min(max(first - half, 0), len(q) - window)
    stop = max(min(last + half + 1, len(q)), start + window)
    kept = slice(first - start, last - start + 1)

    def smooth(values: np.ndarray, derivative: int) -> np.ndarray:
        return _smoothed(values[start:stop], window, derivative, period)[kept]

    relative = np.matmul(matrix[start:stop], matrix[first].T)
    vectors = rotations.continuous(rotations.log(relative))
    vectors = _smoothed(vectors, window)[kept]
    quat = rotations.multiply(rotations.quat_of_vector(vectors), rotations.quat_xyzw(matrix[first]))
    return Demonstration(
        t=np.arange(last - first + 1) * period,
        q=smooth(q, 0),
        position=smooth(position, 0),
        velocity=smooth(position, 1),
        acceleration=smooth(position, 2),
        quat_xyzw=quat,
        rotation_vector=rotation_from(quat, quat[0]),
        period=period,
    )


def smooth_joints(
    stamps_ns: Sequence[int] | np.ndarray,
    q: np.ndarray,
    *,
    period: float = PERIOD,
    cutoff: float = CUTOFF,
    gap_max: float = GAP_MAX,
) -> tuple[np.ndarray, np.ndarray]:
    """All of a recording, resampled on the device's own stamps and smoothed without delay.

    Args:
        stamps_ns: Header stamps [ns], strictly increasing. Shape (M,).
        q: Joint angles [rad]. Shape (M, n).
        period: Of the result [s].
        cutoff: As in `from_joint_samples` [Hz].
        gap_max: Longest time between samples [s].

    Returns:
        Times from 0 [s], shape (N,), and joint angles [rad], shape (N, n).

    Raises:
        ValueError: As `from_joint_samples`, but for a movement there need be none.
    """
    stamps = _checked_stamps(stamps_ns, gap_max)
    q = _resampled(stamps, read_only("q", q, np.shape(q)), round(period * 1e9))
    window = 2 * _half_window(period, cutoff) + 1
    if len(q) < window:
        raise ValueError(
            f"recording of {len(q)} samples at {period} s; smoothing needs at least {window}"
        )
    return np.arange(len(q)) * period, _smoothed(q, window)


def from_positions(position: np.ndarray, period: float) -> Demonstration:
    """A demonstration of positions only: no arm, no turning, no smoothing.

    Args:
        position: [m]. Shape (N, 3).
        period: [s].

    Raises:
        ValueError: Fewer than three samples, a shape, or a value that is not finite.
    """
    position = read_only("position", position, (len(position), 3))
    if len(position) < 3:
        raise ValueError(f"a demonstration of {len(position)} samples; at least 3 are needed")
    velocity = np.gradient(position, period, axis=0, edge_order=2)
    return Demonstration(
        t=np.arange(len(position)) * period,
        q=np.zeros((len(position), 1)),
        position=position,
        velocity=velocity,
        acceleration=np.gradient(velocity, period, axis=0, edge_order=2),
        quat_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (len(position), 1)),
        rotation_vector=np.zeros((len(position), 3)),
        period=period,
    )


def rotation_from(quat_xyzw: np.ndarray, reference_xyzw: np.ndarray) -> np.ndarray:
    """Continuous rotation vectors r with R = exp(r) R_ref [rad].

    Args:
        quat_xyzw: Unit. Shape (N, 4).
        reference_xyzw: R_ref, unit. Shape (4,).

    Returns:
        Shape (N, 3).
    """
    inverse = np.asarray(reference_xyzw) * np.array([-1.0, -1.0, -1.0, 1.0])
    relative = rotations.multiply(quat_xyzw, np.broadcast_to(inverse, np.shape(quat_xyzw)))
    return rotations.continuous(rotations.rotation_vector(relative))


def _checked_stamps(stamps_ns: Sequence[int] | np.ndarray, gap_max: float) -> np.ndarray:
    stamps = np.asarray(stamps_ns)
    if stamps.ndim != 1 or len(stamps) < 2 or not np.issubdtype(stamps.dtype, np.integer):
        raise ValueError(
            f"stamps of shape {stamps.shape} and type {stamps.dtype}; "
            "at least two integers [ns] in a row are needed"
        )
    stamps = stamps.astype(np.int64)
    steps = np.diff(stamps)
    at = int(np.argmin(steps))
    if steps[at] <= 0:
        raise ValueError(f"stamp {stamps[at + 1]} follows {stamps[at]}; stamps must increase")
    at = int(np.argmax(steps))
    if steps[at] > gap_max * 1e9:
        raise ValueError(
            f"gap of {steps[at] * 1e-9} s after stamp {stamps[at]}; at most {gap_max} s allowed"
        )
    return stamps


def _resampled(stamps: np.ndarray, values: np.ndarray, period_ns: int) -> np.ndarray:
    """Straight lines between samples, at the multiples of the period inside the recording."""
    if period_ns <= 0:
        raise ValueError(f"period = {period_ns} ns must be positive")
    first = -(-int(stamps[0]) // period_ns)
    last = int(stamps[-1]) // period_ns
    grid = np.arange(first, last + 1, dtype=np.int64) * period_ns
    left = np.clip(np.searchsorted(stamps, grid, side="right") - 1, 0, len(stamps) - 2)
    share = (grid - stamps[left]) / (stamps[left + 1] - stamps[left])
    return values[left] + share[:, None] * (values[left + 1] - values[left])


def _half_window(period: float, cutoff: float) -> int:
    """Half the Savitzky-Golay window, for a cubic with the given -3 dB cutoff (Schafer 2011)."""
    nyquist = 0.5 / period
    if not 0.0 < cutoff < 0.5 * nyquist:
        raise ValueError(f"cutoff = {cutoff} Hz must be in (0, {0.5 * nyquist}) at {period} s")
    return max(2, math.ceil((4.0 * nyquist / cutoff + 4.6) / 3.2))


def _smoothed(
    values: np.ndarray, window: int, derivative: int = 0, period: float = 1.0
) -> np.ndarray:
    """Savitzky-Golay with a cubic, along the first axis."""
    # Imported when used: it takes longer than all else, and a controller that starts never smooths.
    from scipy.signal import savgol_filter

    return savgol_filter(values, window, 3, deriv=derivative, delta=period, axis=0)


def _movement(speed: np.ndarray, start: float, end: float, period: float) -> tuple[int, int]:
    """First and last sample of the movement that holds the peak speed."""
    for name, share in (("trim_start", start), ("trim_end", end)):
        if not 0.0 < share < 1.0:
            raise ValueError(f"{name} = {share} must be in (0, 1)")
    peak = int(np.argmax(speed))
    if speed[peak] < 0.05:
        raise ValueError(f"peak speed {speed[peak]} m/s; a movement has at least 0.05 m/s")
    before = _reach(speed[peak::-1] >= start * speed[peak], period)
    after = _reach(speed[peak:] >= end * speed[peak], period)
    return peak - before, peak + after


def _reach(fast: np.ndarray, period: float) -> int:
    """Last fast sample from the first on, before a pause above PAUSE_MAX."""
    samples = np.flatnonzero(fast)
    pauses = np.flatnonzero(np.diff(samples) * period > PAUSE_MAX)
    return int(samples[pauses[0]] if len(pauses) else samples[-1])
