# SPDX-License-Identifier: Apache-2.0
"""Quality of a recorded movement: smoothness, limits, completeness, and a grade with reasons."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from wam_power_ros.bags import layout

# Spectral arc length [Balasubramanian2012]
CUTOFF_MAX = 10.0  # [Hz]
AMPLITUDE_MIN = 0.05  # share of the largest amplitude at which the spectrum is cut off
PADDING = 4  # zero padding: next power of two of the length, times 2**PADDING
SMOOTHNESS_MIN = -2.5  # a single smooth movement has about -1.6
RANGE_MIN = 0.05  # range of the joint that moves most [rad]
SPEED_SHARE_MAX = 0.9  # of a speed limit; a rollout may be faster than its demonstration
MARGIN_MIN = 0.02  # distance from a position limit [rad]
ANGLE_USUAL = 10.0  # beyond it no arm turns: more than one and a half turns [rad]
MISSING_SHARE_MAX = 0.05  # of the messages of a topic


class Grade(enum.IntEnum):
    """Grade of a take."""

    GOOD = 0
    FAIR = 1  # usable; look at the reason
    POOR = 2  # not suitable for learning


class Remark(NamedTuple):
    """A reason for a grade."""

    grade: Grade
    text: str


class Limits(NamedTuple):
    """Joint limits: positions [rad] and speeds [rad/s]. Shapes (n,)."""

    q_min: np.ndarray
    q_max: np.ndarray
    qd_max: np.ndarray


class Gaps(NamedTuple):
    """Gaps between the stamps of a topic."""

    period: float  # median interval between messages [s]; 0 without an interval
    missing: int  # number of messages that would fill the intervals longer than 1.5 periods
    longest: float  # longest interval [s]


def gaps(stamps_ns: Sequence[int] | np.ndarray) -> Gaps:
    """Gaps between stamps [ns] as received, shape (M,); those that repeat or go back make none."""
    steps = np.diff(np.asarray(stamps_ns, dtype=np.int64))
    steps = steps[steps > 0]
    if not len(steps):
        return Gaps(0.0, 0, 0.0)
    period = float(np.median(steps))
    missing = np.rint(steps[steps > 1.5 * period] / period) - 1.0
    return Gaps(period * 1e-9, int(missing.sum()), float(steps.max()) * 1e-9)


def smoothness(speed: np.ndarray, period: float) -> float:
    """Spectral arc length of speeds (N,) of any unit, `period` [s] apart: near 0 is smooth."""
    size = 1 << (int(np.ceil(np.log2(len(speed)))) + PADDING)
    frequency = np.fft.rfftfreq(size, period)
    spectrum = np.abs(np.fft.rfft(speed, size))
    kept = frequency <= CUTOFF_MAX
    spectrum, frequency = spectrum[kept] / spectrum.max(), frequency[kept]
    above = np.flatnonzero(spectrum >= AMPLITUDE_MIN)
    inside = slice(above[0], above[-1] + 1)
    f, a = frequency[inside], spectrum[inside]
    width = f[-1] - f[0]
    if width == 0.0:
        return 0.0
    return -float(np.hypot(np.diff(f) / width, np.diff(a)).sum())


def joint_speeds(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Joint speeds of a smooth movement [rad/s]. Shape (N, n)."""
    return np.gradient(q, t, axis=0)


def movement_remarks(
    t: np.ndarray, q: np.ndarray, joint_names: Sequence[str], limits: Limits | None
) -> list[Remark]:
    """Remarks on a smooth movement: evenly spaced times t (N,) from 0 [s], angles q (N, n) [rad].

    Raises:
        ValueError: A joint is beyond its limits, and where no arm turns.
    """
    found = []
    largest = np.ptp(q, axis=0).max()
    if largest < RANGE_MIN:
        return [Remark(Grade.POOR, f"hardly moves: {largest:.3f} rad")]
    qd = joint_speeds(t, q)
    arc = smoothness(np.linalg.norm(qd, axis=1), float(t[1] - t[0]))
    if arc < SMOOTHNESS_MIN:
        found.append(Remark(Grade.FAIR, f"jerky: smoothness {arc:.1f}, below {SMOOTHNESS_MIN:g}"))
    if limits is None or len(limits.q_min) != q.shape[1]:
        return found
    margin = np.minimum(q.min(axis=0) - limits.q_min, limits.q_max - q.max(axis=0))
    joint = int(margin.argmin())
    if margin[joint] < MARGIN_MIN:
        furthest = float(np.abs(q[:, joint]).max())
        if furthest > ANGLE_USUAL:
            text = f"{joint_names[joint]} is at {furthest:.0f} rad, beyond its limit; are these"
            raise ValueError(f"{text} degrees? Convert them to rad")
        where = "beyond" if margin[joint] < 0.0 else "at"
        grade = Grade.POOR if margin[joint] < 0.0 else Grade.FAIR
        found.append(Remark(grade, f"{joint_names[joint]} {where} its position limit"))
    share = np.abs(qd).max(axis=0) / limits.qd_max
    joint = int(share.argmax())
    if share[joint] > SPEED_SHARE_MAX:
        grade = Grade.POOR if share[joint] > 1.0 else Grade.FAIR
        found.append(
            Remark(grade, f"{joint_names[joint]} at {share[joint]:.0%} of its speed limit")
        )
    return found


def completeness_remarks(
    counts: Mapping[str, int], missing: Mapping[str, int], ended: str
) -> list[Remark]:
    """Remarks on missing messages and on a recording that was not stopped on request."""
    usual = ended in ("", layout.STOP_REQUESTED)
    cut = [] if usual else [Remark(Grade.FAIR, f"cut short: {ended}")]
    return cut + [
        Remark(Grade.FAIR, f"{lost} of {lost + counts[topic]} messages missing on {topic}")
        for topic, lost in missing.items()
        if lost > MISSING_SHARE_MAX * (lost + counts[topic])
    ]


def left_out_remark(duration: float, pause: float, at: float, earlier: bool) -> Remark:
    """Remark on movement that a pause cuts off; see `learning.demonstration.LeftOut`."""
    side = "before" if earlier else "after"
    where = f"{side} a pause of {pause:.2f} s at {at:.2f} s"
    return Remark(Grade.FAIR, f"{duration:.1f} s of movement {where} are left out")


def grade(remarks: Sequence[Remark]) -> Grade:
    """Grade of a take: the grade of its worst remark."""
    return max((remark.grade for remark in remarks), default=Grade.GOOD)
