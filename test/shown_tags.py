# SPDX-License-Identifier: Apache-2.0
"""A camera that films a hand-held plate with tags, through a lens with distortion, with noise."""

from __future__ import annotations

import cv2
import numpy as np

from wam_power_ros import rotations
from wam_power_ros.nodes.tag_detector import TagDetector

WIDTH, HEIGHT = 640, 480
K = np.array([[610.0, 0.0, 322.0], [0.0, 610.0, 236.0], [0.0, 0.0, 1.0]])  # as in CameraInfo
D = np.array([-0.28, 0.09, 0.0006, -0.0004, 0.0])
LARGER, CELL, NOISE = 2, 32, 3.0  # ideal image over the real one, pixels of a module, grey values

ONE = "36h11", (3,), 0.06, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
TWO = "36h11", (3, 7), 0.05, (-0.04, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0,
                              0.035, 0.01, -0.005, 0.0, 0.35, 0.0, 0.93674970)  # fmt: skip


def truth(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) [m] and rotation (3, 3) of the plate in the optical frame at a time [s]."""
    place = np.array([0.1 * np.sin(0.9 * t), 0.08 * np.sin(1.3 * t), 0.6 + 0.1 * np.sin(0.7 * t)])
    lean = rotations.exp(np.array([0.5 + 0.1 * np.sin(t), 0.3 * np.sin(0.8 * t), 0.0]))
    return place, lean @ np.diag([1.0, -1.0, -1.0]) @ rotations.exp(np.array([0.0, 0.0, 0.4 * t]))


class Film:
    """The plate in front of the camera."""

    def __init__(self, tags: tuple) -> None:
        family, numbers, size, poses = tags
        name = getattr(cv2.aruco, f"DICT_APRILTAG_{family}")
        known = cv2.aruco.getPredefinedDictionary(name)
        self._tags = []
        for number, pose in zip(numbers, np.reshape(poses, (-1, 7)), strict=True):
            printed = np.full((10, 10), 255, np.uint8)  # with its white margin
            printed[1:-1, 1:-1] = cv2.aruco.generateImageMarker(known, number, 8)
            self._tags.append((np.kron(printed, np.ones((CELL, CELL), np.uint8)), pose))
        step, half = size / 8 / CELL, 0.5 * (10 * CELL - 1)
        self._plane = step * np.array(
            [[1.0, 0.0, -half], [0.0, -1.0, half], [0.0, 0.0, 1.0 / step]]
        )
        centre = 0.65 * LARGER * np.array([WIDTH, HEIGHT])  # the ideal image has room for the lens
        self._ideal = np.diag([LARGER * K[0, 0], LARGER * K[1, 1], 1.0])
        self._ideal[:2, 2] = centre
        pixels = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1)
        rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2).astype(float), K, D)
        self._map = (LARGER * K[1, 1] * rays.reshape(HEIGHT, WIDTH, 2) + centre).astype(np.float32)
        self._size = tuple((2 * centre).astype(int).tolist())
        self._rng = np.random.default_rng(0)

    def image(self, place: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Image of the plate at a pose in the optical frame, a tag after the other."""
        ideal = np.full(self._size[::-1], 128, np.uint8)
        for printed, pose in self._tags:
            turned = rotation @ rotations.matrix(pose[3:])
            to_image = np.column_stack([turned[:, :2], place + rotation @ pose[:3]])
            to_image = self._ideal @ to_image @ self._plane
            border = cv2.BORDER_TRANSPARENT
            cv2.warpPerspective(printed, to_image, self._size, ideal, cv2.INTER_LINEAR, border)
        ideal = cv2.GaussianBlur(ideal, (0, 0), 0.5 * LARGER)
        seen = cv2.remap(ideal, self._map, None, cv2.INTER_LINEAR).astype(float)
        noisy = seen + NOISE * self._rng.standard_normal(seen.shape)
        return np.clip(noisy, 0, 255).astype(np.uint8)


def measure(tags: tuple, count: int = 60) -> dict[str, object]:
    """Errors of poses anywhere in view [mm, degrees], and reasons of those that were not found."""
    film, detector, rng = Film(tags), TagDetector(*tags), np.random.default_rng(1)
    errors, lost = [], []
    for number in range(count):
        depth, about = rng.uniform(0.35, 1.0), rng.uniform(-np.pi, np.pi)
        place = depth * np.array([*rng.uniform(-0.25, 0.25, 2), 1.0])
        axis = np.array([np.cos(about), np.sin(about), 0.0])
        rotation = rotations.exp(rng.uniform(0.3, 0.9) * axis) @ np.diag([1.0, -1.0, -1.0])
        rotation = rotation @ rotations.exp(np.array([0.0, 0.0, rng.uniform(-3.0, 3.0)]))
        image = film.image(place, rotation)
        try:
            found = detector.pose((number + 1) * 10**9, image, K, D)
        except ValueError as error:
            lost.append(str(error))
            continue
        angle = np.linalg.norm(rotations.log(found[1] @ rotation.T))
        errors.append([1e3 * np.linalg.norm(found[0] - place), np.rad2deg(angle)])
    return {"errors": errors, "lost": lost}
