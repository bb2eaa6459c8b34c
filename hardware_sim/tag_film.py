# SPDX-License-Identifier: Apache-2.0
"""A camera that films AprilTags or a ball: lens, exposure and noise; no pose passes by its images.

Only the window of the image around them is drawn, and nothing else is in view.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from wam_power_ros import rotations
from wam_power_ros.tracking.ball_detector import BallDetector
from wam_power_ros.tracking.tag_detector import TagDetector

WIDTH, HEIGHT = 1280, 720  # [px]
K = np.array([[900.0, 0.0, 644.0], [0.0, 900.0, 356.0], [0.0, 0.0, 1.0]])  # as in CameraInfo
D = np.array([-0.28, 0.09, 0.0006, -0.0004, 0.0])
CELL = 16  # pixels of a module of the print
BACKGROUND, NOISE = 128, 3.0  # grey values
SHARPNESS = 0.6  # [px] standard deviation of the blur of the lens
MARGIN = 40  # [px] of the window around the tags, or fewer of them are found
EXPOSURE = 0.004  # [s]
MOMENTS = EXPOSURE * np.array([-0.4, 0.0, 0.4])  # at which its light is taken [s]
# On both faces of a flat body: what `TagDetector` takes.
TAGS = "36h11", (0, 1), 0.09, (0.0, 0.0, 0.004, 0.0, 0.0, 0.0, 1.0,
                                0.0, 0.0, -0.004, 1.0, 0.0, 0.0, 0.0)  # fmt: skip
VIEW = np.array([0.35, 0.3, 1.2])  # [m] of the camera from where it looks
ABOVE = np.array([0.0, 0.0, 0.25])  # [m] of that place above the tool
BESIDE = np.array([0.2, -1.4, 0.1])  # [m] of a camera that films a ball from the tool
ORANGE, HUE = np.array([30.0, 95.0, 225.0], np.float32), 20.0  # BGR; hue [degrees]
LIGHT, SHADE = (
    np.array([0.3, -0.8, -0.52]),
    0.45,
)  # direction of the lamp; share of light without it


class Camera:
    """A calibrated camera beside the arm, and the detector that sees the body in its images.

    It looks above a place (3,) [m], where the body with its tags is at rest; or at it, from where a
    ball with this radius [m] hangs.
    """

    def __init__(self, place: np.ndarray, ball: float = 0.0) -> None:
        self._ball, self._film = ball, BallFilm(ball) if ball else Film(*TAGS)
        self.forget()
        view = BESIDE if ball else VIEW
        away = view / np.linalg.norm(view)
        right = np.cross([0.0, 0.0, 1.0], away)
        right /= np.linalg.norm(right)
        self._turn = np.column_stack([right, np.cross(right, away), -away])  # optical axes
        self._place = place + view + (not ball) * ABOVE

    def forget(self) -> None:
        """Forget the last pose, which else tells which of two is true."""
        ball = self._ball
        self._detector = BallDetector(ball, HUE) if ball else TagDetector(*TAGS)

    def pose(
        self,
        stamp_ns: int,
        position: np.ndarray,
        rotation: np.ndarray,
        twist: np.ndarray | None,
        rng: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Pose (3,) [m], (3, 3) of a body as an image tells it, which its `twist` (6,) blurs.

        Raises:
            ValueError: No tag is seen, or the pose is not known.
        """
        turn = self._turn.T
        seen = turn @ (position - self._place), turn @ rotation
        moving = None if twist is None else np.concatenate([turn @ twist[:3], turn @ twist[3:]])
        image, corner = self._film.window(*seen, rng, moving)
        k = K.copy()
        k[:2, 2] -= corner
        place, turned = self._detector.pose(stamp_ns, image, k, D)
        return self._place + self._turn @ place, self._turn @ turned


class BallFilm:
    """Draws an orange ball with this radius [m] in lamplight as the camera sees it."""

    def __init__(self, radius: float) -> None:
        self._radius, self._rays = radius, _rays()

    def window(
        self,
        place: np.ndarray,
        rotation: np.ndarray,
        rng: np.random.Generator,
        twist: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Part of the image around the ball, colours (h, w, 3) in BGR; see `Film.window`."""
        ends = [place] if twist is None else [place + moment * twist[:3] for moment in MOMENTS]
        found = [
            cv2.projectPoints(each, np.zeros(3), np.zeros(3), K, D)[0].ravel() for each in ends
        ]
        size = K[0, 0] * self._radius / place[2] + MARGIN
        low = np.maximum(np.min(found, axis=0) - size, 0).astype(int)
        high = np.minimum(np.max(found, axis=0) + size, [WIDTH, HEIGHT]).astype(int)
        if place[2] < 0.05 or np.any(high - low < 2 * MARGIN):
            return np.empty((0, 0, 3), np.uint8), np.zeros(2)
        fine = _finer(self._rays[low[1] : high[1], low[0] : high[0]])
        seen = np.mean([self._drawn(fine, each) for each in ends], axis=0)
        return _taken(seen, rng), low.astype(float)

    def _drawn(self, rays: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Colours (h, w, 3) along rays (h, w, 2): of the ball where they meet it."""
        u = np.concatenate([rays, np.ones((*rays.shape[:2], 1), np.float32)], axis=2)
        u /= np.linalg.norm(u, axis=2, keepdims=True)
        middle = u @ place
        depth = middle**2 - place @ place + self._radius**2  # squared half chord
        normal = (u * (middle - np.sqrt(np.maximum(depth, 0.0)))[..., None] - place) / self._radius
        lit = SHADE + (1.0 - SHADE) * np.maximum(normal @ LIGHT, 0.0)
        return np.where(depth[..., None] > 0.0, lit[..., None] * ORANGE, np.float32(BACKGROUND))


def _rays() -> np.ndarray:
    """Rays of the pixels (HEIGHT, WIDTH, 2), at a depth of 1."""
    pixels = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1)
    rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2).astype(float), K, D)
    return rays.reshape(HEIGHT, WIDTH, 2).astype(np.float32)


def _finer(rays: np.ndarray) -> np.ndarray:
    """Rays twice as dense in both directions."""
    return cv2.resize(rays, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)


def _taken(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Image of light that was drawn twice as fine: lens and noise."""
    seen = cv2.resize(light, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    seen = cv2.GaussianBlur(seen, (0, 0), SHARPNESS) + NOISE * rng.standard_normal(seen.shape)
    return np.clip(seen, 0, 255).astype(np.uint8)


class Film:
    """Draws tags of a body as the camera sees them; arguments as of `TagDetector`."""

    def __init__(
        self, family: str, tags: Sequence[int], size: float, poses: Sequence[float]
    ) -> None:
        known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{family}"))
        self._tags = []
        for number, pose in zip(tags, np.reshape(poses, (-1, 7)), strict=True):
            printed = np.full((10, 10), 255, np.uint8)  # with its white margin
            printed[1:-1, 1:-1] = cv2.aruco.generateImageMarker(known, number, 8)
            texture = np.kron(printed, np.ones((CELL, CELL))).astype(np.float32)
            self._tags.append((texture, pose[:3], rotations.matrix(pose[3:])))
        scale, middle = 8 * CELL / size, 0.5 * (10 * CELL - 1)
        self._to_texture = np.array([[scale, 0.0, middle], [0.0, -scale, middle], [0.0, 0.0, 1.0]])
        self._corners = 0.625 * size * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
        self._rays = _rays()

    def window(
        self,
        place: np.ndarray,
        rotation: np.ndarray,
        rng: np.random.Generator,
        twist: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Part of the image around the tags of a body at a pose in the optical frame.

        Args:
            place: Position [m]. Shape (3,).
            rotation: Rotation. Shape (3, 3).
            rng: Draws the noise.
            twist: Velocities in the optical frame [m/s, rad/s]; None for a body at rest. (6,).

        Returns:
            Grey values (h, w), none if nothing is in view, and the column and row where they begin.
        """
        shown = [tag for tag in self._tags if self._faces(place, rotation, *tag[1:])]
        corners = [place + (o + self._corners @ r.T) @ rotation.T for _, o, r in shown]
        if not shown or np.min(corners, axis=(0, 1))[2] < 0.05:
            return np.empty((0, 0), np.uint8), np.zeros(2)
        pixels = cv2.projectPoints(np.vstack(corners), np.zeros(3), np.zeros(3), K, D)[0][:, 0]
        low = np.maximum(pixels.min(axis=0) - MARGIN, 0).astype(int)
        high = np.minimum(pixels.max(axis=0) + MARGIN, [WIDTH, HEIGHT]).astype(int)
        if np.any(high - low < 2 * MARGIN):
            return np.empty((0, 0), np.uint8), np.zeros(2)
        fine = _finer(self._rays[low[1] : high[1], low[0] : high[0]])
        light = np.zeros(fine.shape[:2], np.float32)
        moments = MOMENTS if twist is not None and twist.any() else np.zeros(1)
        for moment in moments:
            moved = np.zeros(6) if twist is None else moment * twist
            turned = rotations.exp(moved[3:]) @ rotation
            light += self._drawn(fine, shown, place + moved[:3], turned)
        return _taken(light / len(moments), rng), low.astype(float)

    def image(
        self, place: np.ndarray, rotation: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Whole image (HEIGHT, WIDTH) of a body at a pose in the optical frame."""
        whole = BACKGROUND + NOISE * rng.standard_normal((HEIGHT, WIDTH))
        seen, (column, row) = self.window(place, rotation, rng)
        height, width = seen.shape
        whole[int(row) : int(row) + height, int(column) : int(column) + width] = seen
        return np.clip(whole, 0, 255).astype(np.uint8)

    @staticmethod
    def _faces(
        place: np.ndarray, rotation: np.ndarray, offset: np.ndarray, turn: np.ndarray
    ) -> bool:
        """Whether a tag at a place and turn in the body faces the camera."""
        return float((rotation @ turn)[:, 2] @ (place + rotation @ offset)) < 0.0

    def _drawn(
        self,
        rays: np.ndarray,
        shown: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
        place: np.ndarray,
        rotation: np.ndarray,
    ) -> np.ndarray:
        """Light (h, w) along rays (h, w, 2), a tag after the other."""
        light = np.full(rays.shape[:2], float(BACKGROUND), np.float32)
        for texture, offset, turn in shown:
            turned = rotation @ turn
            plane = np.column_stack([turned[:, :2], place + rotation @ offset])
            onto = self._to_texture @ np.linalg.inv(plane)
            at = cv2.perspectiveTransform(rays, onto)
            kept = cv2.BORDER_TRANSPARENT
            cv2.remap(texture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, light, kept)
        return light
