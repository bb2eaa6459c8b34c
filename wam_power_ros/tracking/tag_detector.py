# SPDX-License-Identifier: Apache-2.0
"""Pose of a body with AprilTags in an image, by OpenCV.

One tag seen at a small angle has two poses that fit alike: the one near the last pose is taken, and
none if there is no last one.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from wam_power_ros import rotations

FLAT = 1e-3  # [m] of corners in one plane
ERROR_MAX = 2.0  # [px] rms of the corners of a true pose: above, a tag is misread or mismeasured
ALIKE = 1.5  # ratio of the errors of two poses below which either may be the true one
EDGE_ON = 0.2  # sine of the angle between corners in a plane and the view: below, it is a guess
ANGLE_ALIKE = 0.1  # [rad] between two poses that need not be told apart
MEMORY = 300_000_000  # [ns] for which the last pose tells which of two is true
CORNERS = 0.5 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])  # as detected
SAMPLES, REACH = 24, 3.0  # points of an edge, and how far beside it grey values are looked at [px]
ONE = np.eye(3)
Pose = tuple[np.ndarray, np.ndarray]  # position (3,) [m] and rotation (3, 3)


class TagDetector:
    """Finds the pose of a body with tags in grey images.

    Args:
        family: Family of the AprilTags, such as "36h11".
        tags: Numbers of the tags on the body.
        size: Edge of their black squares [m].
        poses: Seven numbers for each tag: position [m] and quaternion xyzw in the body.
    """

    def __init__(
        self, family: str, tags: Sequence[int], size: float, poses: Sequence[float]
    ) -> None:
        dictionary = getattr(cv2.aruco, f"DICT_APRILTAG_{family}")
        settings = cv2.aruco.DetectorParameters()
        settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        known = cv2.aruco.getPredefinedDictionary(dictionary)
        self._detector = cv2.aruco.ArucoDetector(known, settings)
        self._corners = {}  # number of a tag -> its corners in the frame of the body (4, 3) [m]
        for number, pose in zip(tags, np.reshape(poses, (-1, 7)), strict=True):
            turned = rotations.matrix(pose[3:])
            self._corners[number] = size * CORNERS @ turned.T + pose[:3]
        self._last: tuple[int, np.ndarray] | None = None  # stamp [ns], rotation

    def pose(self, stamp_ns: int, grey: np.ndarray, k: np.ndarray, d: np.ndarray) -> Pose:
        """Pose of the body in the camera, of an image (h, w) with its calibration.

        Raises:
            ValueError: No tag of the body is seen, or the pose is not known.
        """
        found, numbers, _ = self._detector.detectMarkers(grey) if grey.size else ((), None, ())
        seen = {} if numbers is None else dict(zip(numbers.ravel().tolist(), found, strict=True))
        ours = [number for number in self._corners if number in seen]
        if not ours:
            raise ValueError(f"no tag of the body in view, but {sorted(seen)}")
        edges = {number: _edges(seen[number].reshape(4, 2)).min() for number in ours}
        ours = [it for it in ours if edges[it] > 0.5 * max(edges.values())]  # not seen edge-on
        points = np.vstack([self._corners[number] for number in ours])
        rays = np.vstack([_corners(grey, seen[number].reshape(4, 2), k, d) for number in ours])
        # Corners in one plane are solved in its own axes: OpenCV needs z = 0.
        centre = points.mean(axis=0)
        _, spread, axes = np.linalg.svd(points - centre)
        axes[2] *= np.linalg.det(axes)
        points = (points - centre) @ axes.T
        method = cv2.SOLVEPNP_IPPE if spread[2] < FLAT else cv2.SOLVEPNP_SQPNP
        _, turns, places, _ = cv2.solvePnPGeneric(points, rays, ONE, None, flags=method)
        fits = []
        for guess in zip(turns, places, strict=True):
            turn, place = cv2.solvePnPRefineLM(points, rays, ONE, None, *guess)
            error = cv2.projectPoints(points, turn, place, ONE, None)[0].reshape(-1, 2) - rays
            error *= k[0, 0]  # to pixels
            rotation = rotations.exp(turn.ravel()) @ axes
            place = place.ravel() - rotation @ centre
            fits.append((float(np.sqrt((error**2).sum(axis=1).mean())), place, rotation))
        fits.sort(key=lambda fit: fit[0])
        candidates = [
            (place, rotation)
            for error, place, rotation in fits
            if error < max(ALIKE * fits[0][0], 0.1) and place[2] > 0.0
        ]
        if not candidates or fits[0][0] > ERROR_MAX:
            raise ValueError(f"tags {ours} do not fit tag_size and tag_poses: {fits[0][0]:.1f} px")
        pose = self._nearest(stamp_ns, candidates)
        place = pose[0] + pose[1] @ centre
        facing = float(abs(place @ (pose[1] @ axes[2])) / np.linalg.norm(place))
        if spread[2] < FLAT and facing < EDGE_ON:
            raise ValueError(f"tags {ours} are seen edge-on")
        self._last = stamp_ns, pose[1]
        return pose

    def _nearest(self, stamp_ns: int, poses: list[Pose]) -> Pose:
        """Of poses that fit alike the one that continues the last one."""
        if self._last is not None and 0 < stamp_ns - self._last[0] < MEMORY:
            last = self._last[1]
            return max(poses, key=lambda pose: float(np.sum(pose[1] * last)))
        for _, rotation in poses[1:]:
            angle = np.linalg.norm(rotations.log(rotation @ poses[0][1].T))
            if angle > ANGLE_ALIKE:
                text = f"two poses fit alike, {np.rad2deg(angle):.0f} degrees apart"
                raise ValueError(f"{text}: turn the tag, or add a second one")
        return poses[0]


def _edges(corners: np.ndarray) -> np.ndarray:
    """Lengths of the edges between corners (4, 2) [px]. Shape (4,)."""
    return np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)


def _corners(grey: np.ndarray, corners: np.ndarray, k: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Corners of a tag without distortion, at depth 1: where lines along its edges cross. (4, 2).

    Corners themselves are rounded by the blur of the lens, and then found too far inside. `corners`
    (4, 2) [px] are nearly right and go clockwise.
    """
    along = np.roll(corners, -1, axis=0).astype(float) - corners  # (4, 2)
    lengths = _edges(corners)
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1) / lengths[:, None]
    on = corners[:, None] + np.linspace(0.12, 0.88, SAMPLES)[:, None] * along[:, None]  # (4, n, 2)
    reach = min(REACH, 0.1 * lengths.min())
    beside = np.linspace(-reach, reach, 25)
    grid = on[:, :, None] + beside[:, None] * outward[:, None, None]  # (4, n, 25, 2)
    grid = grid.reshape(4 * SAMPLES, len(beside), 2).astype(np.float32)
    values = cv2.remap(grey, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR).astype(float)
    rise = np.clip(np.diff(values, axis=1), 0.0, None) ** 2  # from black to white
    shift = rise @ (0.5 * (beside[1:] + beside[:-1])) / (rise.sum(axis=1) + 1e-9)
    points = on + shift.reshape(4, SAMPLES, 1) * outward[:, None]
    flat = cv2.undistortPoints(points.reshape(-1, 1, 2), k, d).reshape(4, SAMPLES, 2)
    centre = flat.mean(axis=1)
    normal = np.linalg.svd(flat - centre[:, None])[2][:, 1]  # (4, 2)
    distance = np.sum(normal * centre, axis=1)
    pairs = np.stack([np.roll(normal, 1, axis=0), normal], axis=1)  # edges that meet at a corner
    distances = np.stack([np.roll(distance, 1), distance], axis=1)
    return np.linalg.solve(pairs, distances[:, :, None])[:, :, 0]
