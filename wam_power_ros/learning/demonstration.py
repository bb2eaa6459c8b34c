# SPDX-License-Identifier: Apache-2.0
"""Demonstrations: joint samples of a hand-guided arm, resampled on the control grid, smoothed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.policy import ANGLE_MAX, PERIOD, read_only

CUTOFF = 9.0  # -3 dB of the smoothing, above hand motion, below quantisation noise [Hz]
GAP_MAX = 0.05  # longest gap that is interpolated [s]
SPEED_MIN = 0.05  # smallest peak speed of a movement [m/s]
# Smallest peak angular speed of a movement that only turns the tool [rad/s]: that of SPEED_MIN on a
# lever of 0.25 m, such as a wrist with a pan.
ANGULAR_SPEED_MIN = 0.2
MOMENT = 0.1  # shortest movement beyond a pause that counts as left out [s]


class ToolPose(Protocol):
    """Forward kinematics of an arm with n joints."""

    n: int

    def tool_pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and rotation matrix (3, 3) of the tool frame in the base frame."""


class LeftOut(NamedTuple):
    """Movement of a recording that a demonstration leaves out, beyond a pause."""

    duration: float  # total time for which the tool moved beyond the pause [s]
    pause: float  # time between the movement that is kept and the nearest of it [s]
    at: float  # begin of the pause since the first sample of the recording [s]
    earlier: bool  # True for movement before the pause, False for movement after it


@dataclass(frozen=True, eq=False)
class Demonstration:
    """A movement sampled at a constant period; arrays are read-only.

    Raises:
        ValueError: If a shape is wrong, a value not finite, or there are fewer than three samples.
    """

    t: np.ndarray  # from 0 [s], shape (N,)
    q: np.ndarray  # joint angles [rad], shape (N, nj)
    position: np.ndarray  # of the tool frame in the base frame [m], shape (N, 3)
    velocity: np.ndarray  # [m/s], shape (N, 3)
    acceleration: np.ndarray  # [m/s^2], shape (N, 3)
    quat_xyzw: np.ndarray  # orientation of the tool frame, unit quaternions, shape (N, 4)
    period: float  # of the samples [s]
    left_out: tuple[LeftOut, ...] = ()  # movement of the recording beyond a pause

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
        ):
            object.__setattr__(self, name, read_only(name, getattr(self, name), shape))

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.t[-1])


@dataclass(frozen=True)
class Movement:
    """How a movement is cut out of a recording, around the peak speed of the tool, and smoothed.

    The angular speed counts where the tool only turns.
    """

    cutoff: float = CUTOFF  # -3 dB of the smoothing [Hz]
    # Fractions of the peak speed at which it begins and ends [1]; a slow start would coarsen the
    # fit.
    start: float = 0.15
    end: float = 0.05
    pause_max: float = 0.25  # longest pause at a turning point; a longer one ends it [s]


MOVEMENT = Movement()


def from_joint_samples(
    arm: ToolPose,
    stamps_ns: Sequence[int] | np.ndarray,
    q: np.ndarray,
    movement: Movement = MOVEMENT,
) -> Demonstration:
    """Resample by the device's stamps, smooth without delay, differentiate and trim.

    The grid is the integer multiples of the period, and every step is local in time. The trimmed
    movement is therefore the same, bit for bit, however long the arm rested before or after.

    Args:
        stamps_ns: Header stamps, strictly increasing [ns]. Shape (M,).
        q: Joint angles [rad]. Shape (M, arm.n).
        movement: How to trim and smooth; fractions of 0 keep the whole recording.

    Raises:
        ValueError: If stamps do not increase, there is a gap, a value is not finite, a shape is
            wrong, the recording is too short or the tool does not move.
    """
    half = half_window(movement.cutoff)
    q = _resampled(stamps_ns, q, arm.n, half)  # (N, nj)
    poses = [arm.tool_pose(row) for row in q]
    position = np.array([pose[0] for pose in poses])
    matrix = np.array([pose[1] for pose in poses])
    velocity = _smoothed(position, half, 1)
    speed, turning = np.linalg.norm(velocity, axis=1), _angular_speed(matrix, half)
    only_turns = speed.max() < SPEED_MIN
    if only_turns and turning.max() < ANGULAR_SPEED_MIN:
        raise ValueError(
            f"peak speed {speed.max()} m/s; a movement has at least {SPEED_MIN} m/s, or turns the "
            f"tool by at least {ANGULAR_SPEED_MIN} rad/s"
        )
    first, last = _extent(turning if only_turns else speed, movement)
    moves = turning >= max(movement.start * turning[first : last + 1].max(), ANGULAR_SPEED_MIN)
    if not only_turns:
        moves |= speed >= movement.start * speed.max()
    kept = slice(first, last + 1)
    # Smoothing reaches half a window beyond the movement, and so far the vectors are continuous.
    start = min(max(first - half, 0), len(q) - (2 * half + 1))
    reached = slice(start, max(last + half, start + 2 * half) + 1)
    vectors = rotations.log(np.matmul(matrix[reached], matrix[first].T))
    vectors = _smoothed(rotations.continuous(vectors), half)[first - start : last - start + 1]
    quat = rotations.multiply(rotations.quat_of_vector(vectors), rotations.quat_xyzw(matrix[first]))
    return Demonstration(
        t=np.arange(last - first + 1) * PERIOD,
        q=_smoothed(q, half)[kept],
        position=_smoothed(position, half)[kept],
        velocity=velocity[kept],
        acceleration=_smoothed(position, half, 2)[kept],
        quat_xyzw=quat,
        period=PERIOD,
        left_out=_left_out(moves, first, last, movement.pause_max),
    )


def smooth_joints(
    stamps_ns: Sequence[int] | np.ndarray, q: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Resample a whole recording, as of `from_joint_samples`, and smooth it without delay.

    Returns:
        Times from 0 [s], shape (N,), and joint angles [rad], shape (N, n).

    Raises:
        ValueError: As `from_joint_samples`, except that the arm need not move.
    """
    joints = np.shape(q)[1] if np.ndim(q) == 2 else 1
    half = half_window(CUTOFF)
    q = _resampled(stamps_ns, q, joints, half)
    return np.arange(len(q)) * PERIOD, _smoothed(q, half)


def from_positions(position: np.ndarray, period: float) -> Demonstration:
    """Make a demonstration of positions (N, 3) [m] alone, one each `period` [s]; no smoothing.

    Raises:
        ValueError: If there are fewer than three samples, a shape is wrong or a value not finite.
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
        period=period,
    )


def rotation_from(quat_xyzw: np.ndarray, reference_xyzw: np.ndarray) -> np.ndarray:
    """Continuous rotation vectors r [rad] with R = exp(r) R_ref. Shape (N, 3).

    Orientations R (N, 4) and R_ref (4,) are unit quaternions.
    """
    inverse = np.asarray(reference_xyzw) * np.array([-1.0, -1.0, -1.0, 1.0])
    relative = rotations.multiply(quat_xyzw, np.broadcast_to(inverse, np.shape(quat_xyzw)))
    return rotations.continuous(rotations.rotation_vector(relative))


def _checked_stamps(stamps_ns: Sequence[int] | np.ndarray) -> np.ndarray:
    stamps = np.asarray(stamps_ns)
    if stamps.ndim != 1 or len(stamps) < 2 or not np.issubdtype(stamps.dtype, np.integer):
        raise ValueError(
            f"stamps of shape {stamps.shape} and type {stamps.dtype}; "
            "they must be a list of at least two integers [ns]"
        )
    stamps = stamps.astype(np.int64)
    steps = np.diff(stamps)
    at = int(np.argmin(steps))
    if steps[at] <= 0:
        raise ValueError(f"stamp {stamps[at + 1]} follows {stamps[at]}; stamps must increase")
    at = int(np.argmax(steps))
    if steps[at] > GAP_MAX * 1e9:
        when = f"{(stamps[at] - stamps[0]) * 1e-9:.3f} s after the first state"
        how = "if a part is enough: wam-power bags import BAG --part START END"
        raise ValueError(f"gap of {steps[at] * 1e-9} s, {when}; at most {GAP_MAX} s allowed; {how}")
    return stamps


def half_window(cutoff: float) -> int:
    """Half the window of the Savitzky-Golay filter with this cutoff [Hz], in samples.

    Degrees 2 and 3 smooth alike [Schafer2011].
    """
    return math.ceil((1.5 / (PERIOD * cutoff) + 4.6) / 3.2)


def _resampled(
    stamps_ns: Sequence[int] | np.ndarray, q: np.ndarray, joints: int, half: int
) -> np.ndarray:
    """Interpolate samples linearly at the multiples of the period. Shape (N, joints)."""
    stamps = _checked_stamps(stamps_ns)
    q = read_only("q", q, (len(stamps), joints))
    sample, joint = np.unravel_index(np.argmax(np.abs(q)), q.shape)
    if abs(largest := float(q[sample, joint])) > ANGLE_MAX:
        raise ValueError(
            f"q[{sample}, {joint}] = {largest:g} rad at stamp {stamps[sample]}; at most "
            f"{ANGLE_MAX:g} rad in magnitude are allowed; degrees?"
        )
    period_ns = round(PERIOD * 1e9)
    first = -(-int(stamps[0]) // period_ns)
    last = int(stamps[-1]) // period_ns
    grid = np.arange(first, last + 1, dtype=np.int64) * period_ns
    if len(grid) <= 2 * half:
        raise ValueError(
            f"recording of {len(grid)} samples at {PERIOD} s; smoothing needs at least "
            f"{2 * half + 1}"
        )
    left = np.clip(np.searchsorted(stamps, grid, side="right") - 1, 0, len(stamps) - 2)
    share = (grid - stamps[left]) / (stamps[left + 1] - stamps[left])
    return q[left] + share[:, None] * (q[left + 1] - q[left])


def _smoothed(values: np.ndarray, half: int, derivative: int = 0) -> np.ndarray:
    """Smooth along the first axis by a cubic Savitzky-Golay filter, or differentiate by it."""
    # Imported here: the import is slow, and the controller does not need it at its start.
    from scipy.signal import savgol_filter

    return savgol_filter(values, 2 * half + 1, 3, deriv=derivative, delta=PERIOD, axis=0)


def _angular_speed(matrix: np.ndarray, half: int) -> np.ndarray:
    """Angular speed [rad/s] (N,) of rotation matrices (N, 3, 3) on the grid, smoothed."""
    steps = rotations.log(np.matmul(matrix[1:], np.swapaxes(matrix[:-1], 1, 2)))
    return np.linalg.norm(_smoothed(np.concatenate([steps[:1], steps]), half), axis=1) / PERIOD


def _extent(speed: np.ndarray, movement: Movement) -> tuple[int, int]:
    """First and last sample of the movement around the peak of `speed` (N,)."""
    peak = int(np.argmax(speed))
    before = _moving(speed[peak::-1] >= movement.start * speed[peak], movement.pause_max)
    after = _moving(speed[peak:] >= movement.end * speed[peak], movement.pause_max)
    return peak - before, peak + after


def _left_out(moves: np.ndarray, first: int, last: int, pause_max: float) -> tuple[LeftOut, ...]:
    """Movement beyond a pause before sample `first` and after `last`; `moves` is of shape (N,)."""
    found = []
    for beyond, earlier in ((moves[:first][::-1], True), (moves[last + 1 :], False)):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], beyond, [False]])))
        begins, ends = edges[::2], edges[1::2]
        counted = ((ends - begins) * PERIOD >= MOMENT) & (begins * PERIOD >= pause_max)
        if counted.any():
            duration = float((ends - begins)[counted].sum()) * PERIOD
            pause = int(begins[counted][0])
            at = first - pause if earlier else last
            found.append(LeftOut(duration, pause * PERIOD, at * PERIOD, earlier))
    return tuple(found)


def _moving(fast: np.ndarray, pause_max: float) -> int:
    """Index of the last fast sample before the first pause longer than `pause_max` [s]."""
    samples = np.flatnonzero(fast)
    pauses = np.flatnonzero(np.diff(samples) * PERIOD > pause_max)
    return int(samples[pauses[0]] if len(pauses) else samples[-1])
