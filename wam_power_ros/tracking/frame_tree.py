# SPDX-License-Identifier: Apache-2.0
"""Poses of frames in each other, from their poses in their parents, as /tf publishes them."""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

import numpy as np

from wam_power_ros import rotations

KEPT = 3_000_000_000  # poses of a moving frame are kept for so long [ns]: no image is older
STILL = 1e-6  # [m] and [1] by which two poses of a frame at rest may differ
IDENTITY = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])
Pose = tuple[np.ndarray, np.ndarray]  # position (3,) [m] and unit quaternion xyzw (4,)


class _Link(NamedTuple):
    """Poses of a frame in its parent; only the last one counts if it is fixed."""

    parent: str
    fixed: bool
    stamps: list[int]
    poses: list[Pose]


def compose(outer: Pose, inner: Pose) -> Pose:
    """Pose `inner`, given in a frame whose pose is `outer`, where `outer` is given."""
    position = outer[0] + rotations.matrix(outer[1]) @ inner[0]
    return position, rotations.multiply(outer[1], inner[1])


class FrameTree:
    """Frames, each with its poses in its parent; names are without a leading slash."""

    def __init__(self) -> None:
        self._links: dict[str, _Link] = {}

    def add(self, frame: str, parent: str, stamp_ns: int, pose: Pose, fixed: bool) -> None:
        """Add the pose of a frame in its parent at a time [ns]; at all times if it is fixed."""
        link = self._links.get(frame)
        if link is None or (link.parent, link.fixed) != (parent, fixed):
            link = self._links[frame] = _Link(parent, fixed, [], [])
        if fixed or (link.stamps and stamp_ns <= link.stamps[-1] - KEPT):  # or a clock set back
            link.stamps.clear()
            link.poses.clear()
        place = bisect_left(link.stamps, stamp_ns)
        if link.stamps[place : place + 1] == [stamp_ns]:
            return
        link.stamps.insert(place, stamp_ns)
        link.poses.insert(place, pose)
        while link.stamps[-1] - link.stamps[0] > KEPT:
            del link.stamps[0], link.poses[0]

    def pose(self, frame: str, target: str, stamp_ns: int) -> Pose:
        """Pose of a frame in a target frame at a time [ns].

        Raises:
            ValueError: They are not connected, or a frame between them moves and its pose is not
                known at that time.
        """
        up, down = self._to_root(frame), self._to_root(target)
        common = next((each for each in up if each in down), None)
        if common is None:
            known = sorted({*self._links, *(link.parent for link in self._links.values())})
            raise ValueError(f"{frame!r} is not connected to {target!r}; /tf has {known[:30]}")
        inner, outer = IDENTITY, IDENTITY
        for each in up[: up.index(common)]:
            inner = compose(self._in_parent(each, stamp_ns), inner)
        for each in down[: down.index(common)]:
            outer = compose(self._in_parent(each, stamp_ns), outer)
        back = outer[1] * np.array([-1.0, -1.0, -1.0, 1.0])
        return compose((-rotations.matrix(back) @ outer[0], back), inner)

    def _to_root(self, frame: str) -> list[str]:
        frames = [frame]
        while (link := self._links.get(frames[-1])) and link.parent not in frames:
            frames.append(link.parent)
        return frames

    def _in_parent(self, frame: str, stamp_ns: int) -> Pose:
        """Pose of a frame in its parent, between those before and after a time."""
        _, fixed, stamps, poses = self._links[frame]
        right = bisect_left(stamps, stamp_ns)
        if fixed or (right == len(stamps) and _at_rest(poses)):
            return poses[-1]
        if right < len(stamps) and stamps[right] == stamp_ns:
            return poses[right]
        if not 0 < right < len(stamps):
            late = (stamp_ns - stamps[-1 if right else 0]) * 1e-6
            age = f"{abs(late):.1f} ms {'older' if late > 0.0 else 'newer'} than this"
            raise ValueError(f"{frame!r} moves, and its pose is not known at this time: {age}")
        times = np.array([0.0, (stamps[right] - stamps[right - 1]) * 1e-9])
        t = (stamp_ns - stamps[right - 1]) * 1e-9
        (before, turned), (after, turned_after) = poses[right - 1], poses[right]
        quats = rotations.interpolate(np.array([t]), times, np.array([turned, turned_after]))
        return before + (after - before) * (t / times[1]), quats[0]


def _at_rest(poses: list[Pose]) -> bool:
    """Whether the last two poses are equal: the next ones will be, too."""
    if len(poses) < 2:
        return False
    (p, q), (p_last, q_last) = poses[-2:]
    return bool(np.abs(p - p_last).max() < STILL and 1.0 - abs(q.dot(q_last)) < STILL**2)
