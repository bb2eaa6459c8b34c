# SPDX-License-Identifier: Apache-2.0
"""Pose of a rigid body from an unlabelled marker cloud, found by its marker layout.

Marker labels of the motion capture are not used, because they swap after occlusions. Markers are
identified by their mutual distances, so the six distances of the layout are all different. The pose
is then the least-squares rigid fit [Kabsch1976].
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from wam_power_ros import rotations

# Markers in the body frame, the body's centre at 0 [m]. Distances differ by >= 18 mm. Shape (4, 3).
LAYOUT = np.array(
    [[-0.056, -0.037, 0.0], [-0.022, 0.072, 0.0], [0.028, -0.071, 0.0], [-0.054, 0.033, 0.0]]
)
LAYOUT.flags.writeable = False

TOLERANCE = 0.006  # largest error of a distance between two markers [m]
COUNT_MIN = 3  # smallest number of markers that determine a pose
COUNT_MAX = 64  # largest number of points of a cloud that is searched


class MarkerFit(NamedTuple):
    """Pose of the layout in a marker cloud.

    Attributes:
        position: Position of the origin of the layout, in the frame of the cloud [m]. Shape (3,).
        quat_xyzw: Orientation of the layout, unit quaternion. Shape (4,).
        rms: Root mean square of the distances between markers and points [m].
        markers: Number of markers in view.
    """

    position: np.ndarray
    quat_xyzw: np.ndarray
    rms: float
    markers: int


def fit(points: np.ndarray) -> MarkerFit:
    """Find the layout in a cloud, which may have other points; one marker may be hidden.

    Args:
        points: Points in any order [m]. Shape (m, 3).

    Raises:
        ValueError: If there are too few or too many points, or the layout is not found or is
            ambiguous.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"markers of shape {points.shape} must be finite and of shape (m, 3)")
    if not COUNT_MIN <= len(points) <= COUNT_MAX:
        raise ValueError(
            f"{len(points)} markers in view; from {COUNT_MIN} to {COUNT_MAX} are needed"
        )
    expected = _distances(LAYOUT)
    measured = _distances(points)
    for count in range(len(LAYOUT), COUNT_MIN - 1, -1):
        fits = [
            _rigid(LAYOUT[list(subset)], points[list(match)])
            for subset in itertools.combinations(range(len(LAYOUT)), count)
            for match in _matches(expected[np.ix_(subset, subset)], measured)
        ]
        fits = [candidate for candidate in fits if candidate.rms < TOLERANCE]
        if len(fits) > 1:
            raise ValueError(
                f"layout found {len(fits)} times in {len(points)} markers; it must be unique"
            )
        if fits:
            return fits[0]
    raise ValueError(f"layout not found in {len(points)} markers")


def _distances(points: np.ndarray) -> np.ndarray:
    """Distances between all pairs of points (m, 3). Shape (m, m)."""
    return np.linalg.norm(points[:, None] - points[None], axis=2)


def _matches(expected: np.ndarray, measured: np.ndarray) -> Iterator[tuple[int, ...]]:
    """Yield every selection of points with the expected distances (k, k), by depth-first search."""
    size = len(expected)
    stack: list[tuple[int, ...]] = [(point,) for point in range(len(measured))]
    while stack:
        match = stack.pop()
        if len(match) == size:
            yield match
            continue
        error = np.abs(measured[list(match)] - expected[: len(match), len(match), None])  # (k, m)
        for point in np.flatnonzero((error < TOLERANCE).all(axis=0)):
            stack.append((*match, int(point)))


def _rigid(body: np.ndarray, points: np.ndarray) -> MarkerFit:
    """Least-squares rotation and translation from body (k, 3) to points (k, 3)."""
    body_mean, mean = body.mean(axis=0), points.mean(axis=0)
    u, _, vt = np.linalg.svd((points - mean).T @ (body - body_mean))
    turn = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])  # a rotation, not a reflection
    matrix = u @ turn @ vt
    position = mean - matrix @ body_mean
    error = points - (body @ matrix.T + position)
    rms = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
    return MarkerFit(position, rotations.quat_xyzw(matrix), rms, len(body))
