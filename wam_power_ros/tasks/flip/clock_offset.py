# SPDX-License-Identifier: Apache-2.0
"""Offset of the cameras' stamps from the arm's, from the movement that both see.

Until the pan is fastest upwards it carries the pancake, whose height above the floor is constant.
With stamps that are late by d, the height n(t - d) . (p(t) - p_pan(t - d)) is; an error of d moves
it by as much times the speed of the pan, 2 to 6 mm for 2 ms.
"""

from __future__ import annotations

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath

CORRECTED_MAX = 0.06  # largest offset that is corrected [s]
_SEARCHED = 0.15  # largest one that is looked for [s]
_STEP = 0.001  # of the search [s]
_APART = 0.008  # from which on two offsets are not the same one [s]
_UNCORRECTED = 0.0025  # up to which it is within the accuracy of the search [s]
_STD_MAX = 0.0015  # with a larger one the movement is too slow to tell [s]
_SLIP = 0.001  # standard deviation of the height of a pancake that is carried [m]
_HOP = 0.006  # change of height beyond which it was not carried in this frame [m]
_LEAVES = 0.01  # before the pan is seen fastest it may have left it [s]
_CARRIED_HEIGHT = 0.03  # height of a frame in which it may be carried [m]
_CARRIED_MIN = 0.8  # share of the frames before the release in which it is, unless it hops
_LEAD_MIN = 3.0  # by how many frames an offset must be better than others if it does


def clock_offset(pan: EndEffectorPath, pancake: BodyPath, before: BodyPath | None) -> float:
    """How late the stamps of a pancake are [s]: 0 if by too little, or if no movement shows it."""
    parts = [part for part in (before, pancake) if part is not None]
    stamps = np.concatenate([part.t for part in parts])
    place = np.concatenate([part.position for part in parts]) - pan.position[0]  # (M, 3)
    normal = rotations.matrix(pan.quat_xyzw)[:, :, 2]  # (T, 3)
    floor = np.sum(normal * (pan.position - pan.position[0]), axis=1)  # (T,)
    speed = np.gradient(floor, pan.t) if len(pan.t) > 1 else np.zeros(1)
    offsets = np.arange(-_SEARCHED, _SEARCHED + 0.5 * _STEP, _STEP)  # (K,)
    t = stamps - offsets[:, None]  # (K, M)
    height = -np.interp(t, pan.t, floor)
    for axis in range(3):
        height += np.interp(t, pan.t, normal[:, axis]) * place[:, axis]
    carried = t < pan.t[int(np.argmax(speed))] - _LEAVES
    best, _ = _steadiest(height, carried, 0.0)
    share = np.mean(_off(height[best, carried[best]]) < 1.0) if carried[best].any() else 0.0
    used = carried[best]
    if share < _CARRIED_MIN:  # it hops: whatever the pan carries, after the flight too
        best, lead = _steadiest(height, np.abs(height) < _CARRIED_HEIGHT, 1.0)
        used = (np.abs(height[best]) < _CARRIED_HEIGHT) & (lead * len(stamps) > _LEAD_MIN)
    seen = float(np.linalg.norm(np.interp(t[best, used], pan.t, speed)))
    late = float(offsets[best])
    return late if abs(late) > _UNCORRECTED and _SLIP < seen * _STD_MAX else 0.0


def _off(height: np.ndarray) -> np.ndarray:
    """Distances of heights from most of them, in units of a hop and at most 1."""
    return np.minimum(np.abs(height - np.median(height)) / _HOP, 1.0)


def _steadiest(height: np.ndarray, used: np.ndarray, unused: float) -> tuple[int, float]:
    """Row of heights (K, M) of which the `used` ones vary least, and its lead on other rows.

    An `unused` one counts as so many hops.
    """
    hops, most = np.full(len(height), 2.0), int(np.max(np.sum(used, axis=1)))
    for number, (row, kept) in enumerate(zip(height, used, strict=True)):
        if 2 * np.sum(kept) > most:  # few frames vary little
            others = unused * np.sum(~kept)
            hops[number] = (np.sum(_off(row[kept]) ** 2) + others) / (np.sum(kept) + others)
    best = int(np.argmin(hops))
    others = np.abs(np.arange(len(hops)) - best) * _STEP > _APART
    return best, float(np.min(hops[others]) - hops[best])


def shifted(
    pancake: BodyPath, before: BodyPath | None, late: float
) -> tuple[BodyPath, BodyPath | None]:
    """Frames with stamps that were `late` [s], from the start on and before it."""
    if not late:
        return pancake, before
    parts = [part for part in (before, pancake) if part is not None]
    t = np.concatenate([part.t for part in parts]) - late
    position = np.concatenate([part.position for part in parts])
    path = BodyPath(pancake.id, t, position, np.concatenate([part.quat_xyzw for part in parts]))
    return path.part(t >= 0.0), path.part(t < 0.0)


def stamps_off(late: float) -> str:
    """Say that stamps are too late to be corrected [s], and what to do."""
    return (
        f"the cameras' stamps are {late * 1e3:+.0f} ms late on the arm's movement: synchronise the "
        f"clocks, or add {late:.3f} to latency_offset"
    )
