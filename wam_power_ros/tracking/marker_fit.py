# SPDX-License-Identifier: Apache-2.0
"""Pose of a rigid body from an unlabelled marker cloud, by the shape of its marker layout.

No identity from the motion capture is trusted: after a loss of view they swap. Which point is which
marker follows from the distances between the points, which is why the layout's six distances all
differ. The pose is then the least-squares rigid fit (Kabsch 1976).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from wam_power_ros import rotations

LAYOUT = (
    np.array(  # (4, 3) [m] in the pancake's frame: centre at 0, flat; distances differ by 18 mm
        [
            [-0.056, -0.037, 0.0],
            [-0.022, 0.072, 0.0],
            [0.028, -0.071, 0.0],
            [-0.054, 0.033, 0.0],
        ]
    )
)
LAYOUT.flags.writeable = False

TOLERANCE = 0.006  # [m] two points fit a distance of the layout when they differ by less
FEWEST = 3  # markers that make a pose
MOST = 64  # points of a cloud that are searched


class MarkerFit(NamedTuple):
    """A pose found in a cloud.

    Attributes:
        position: Of the layout's origin, in the frame of the cloud [m]. Shape (3,).
        quat_xyzw: Of the layout's axes. Shape (4,).
        rms: Of the distances between markers and points [m].
        count: Markers seen.
    """

    position: np.ndarray
    quat_xyzw: np.ndarray
    rms: float
    count: int


def fit(points: np.ndarray, layout: np.ndarray = LAYOUT, tolerance: float = TOLERANCE) -> MarkerFit:
    """Find the layout in a cloud; points of other things may lie about, one marker may be hidden.

    Args:
        points: In any order [m]. Shape (m, 3).
        layout: Marker positions in the body's frame, no two distances alike [m]. Shape (n, 3).
        tolerance: Largest error of a distance between two markers [m].

    Raises:
        ValueError: Too few points, too many, no layout among them, or more than one place for it.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"markers of shape {points.shape} must be finite and of shape (m, 3)")
    if not FEWEST <= len(points) <= MOST:
        raise ValueError(f"{len(points)} markers in view; from {FEWEST} to {MOST} are needed")
    wanted = _distances(layout)
    found = _distances(points)
    for count in range(len(layout), FEWEST - 1, -1):
        fits = [
            _rigid(layout[list(subset)], points[list(match)])
            for subset in itertools.combinations(range(len(layout)), count)
            for match in _matches(wanted[np.ix_(subset, subset)], found, tolerance)
        ]
        fits = [candidate for candidate in fits if candidate.rms < tolerance]
        if len(fits) > 1:
            raise ValueError(f"{len(fits)} ways to see the layout in {len(points)} markers")
        if fits:
            return fits[0]
    raise ValueError(f"the layout is not among {len(points)} markers")


def _distances(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points[:, None] - points[None], axis=2)  # (m, m)


def _matches(wanted: np.ndarray, found: np.ndarray, tolerance: float) -> Iterator[tuple[int, ...]]:
    """Every choice of points whose distances are those wanted, grown marker by marker."""
    size = len(wanted)
    stack: list[tuple[int, ...]] = [(point,) for point in range(len(found))]
    while stack:
        match = stack.pop()
        if len(match) == size:
            yield match
            continue
        error = np.abs(found[list(match)] - wanted[: len(match), len(match), None])  # (k, m)
        for point in np.flatnonzero((error < tolerance).all(axis=0)):
            stack.append((*match, int(point)))


def _rigid(body: np.ndarray, points: np.ndarray) -> MarkerFit:
    """Rotation and translation that bring body (k, 3) to points (k, 3), least squares."""
    centre, middle = body.mean(axis=0), points.mean(axis=0)
    u, _, vt = np.linalg.svd((points - middle).T @ (body - centre))
    turn = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])  # a rotation, never a mirror
    matrix = u @ turn @ vt
    position = middle - matrix @ centre
    error = points - (body @ matrix.T + position)
    rms = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
    return MarkerFit(position, rotations.quat_xyzw(matrix), rms, len(body))
