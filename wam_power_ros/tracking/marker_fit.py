# SPDX-License-Identifier: Apache-2.0
"""Pose of a rigid body from an unlabelled marker cloud, by the shape of its marker layout.

Marker labels of the motion capture are not used: they swap after an occlusion. Markers are told
apart by their distances, which is why the layout's six distances all differ. The pose is then the
least-squares rigid fit [Kabsch1976].
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from wam_power_ros import rotations

LAYOUT = np.array(  # (4, 3) [m] in the body's frame: centre at 0, flat; distances differ by 18 mm
    [
        [-0.056, -0.037, 0.0],
        [-0.022, 0.072, 0.0],
        [0.028, -0.071, 0.0],
        [-0.054, 0.033, 0.0],
    ]
)
LAYOUT.flags.writeable = False

TOLERANCE = 0.006  # error of a distance between two markers [m]
COUNT_MIN = 3  # number of markers that determine a pose
COUNT_MAX = 64  # number of points of a cloud that is searched


class MarkerFit(NamedTuple):
    """A pose found in a cloud.

    Attributes:
        position: Position of the layout's origin, in the frame of the cloud [m]. Shape (3,).
        quat_xyzw: Orientation of the layout. Shape (4,).
        rms: Root mean square of the distances between markers and points [m].
        markers: Number of markers in view.
    """

    position: np.ndarray
    quat_xyzw: np.ndarray
    rms: float
    markers: int


def fit(points: np.ndarray) -> MarkerFit:
    """Find the layout in a cloud with points of other objects; one marker may be hidden.

    Args:
        points: Points in any order [m]. Shape (m, 3).

    Raises:
        ValueError: If there are too few points or too many, or the layout is found nowhere among
            them or more than once.
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
            raise ValueError(f"{len(fits)} ways to see the layout in {len(points)} markers")
        if fits:
            return fits[0]
    raise ValueError(f"the layout is not among {len(points)} markers")


def _distances(points: np.ndarray) -> np.ndarray:
    """Distances between all pairs of points (m, 3). Shape (m, m)."""
    return np.linalg.norm(points[:, None] - points[None], axis=2)


def _matches(expected: np.ndarray, measured: np.ndarray) -> Iterator[tuple[int, ...]]:
    """Yield every choice of points with the expected distances (k, k), grown marker by marker."""
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
    """Rotation and translation from body (k, 3) to points (k, 3) by least squares."""
    body_mean, mean = body.mean(axis=0), points.mean(axis=0)
    u, _, vt = np.linalg.svd((points - mean).T @ (body - body_mean))
    turn = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])  # a rotation, not a reflection
    matrix = u @ turn @ vt
    position = mean - matrix @ body_mean
    error = points - (body @ matrix.T + position)
    rms = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
    return MarkerFit(position, rotations.quat_xyzw(matrix), rms, len(body))
