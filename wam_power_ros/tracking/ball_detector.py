# SPDX-License-Identifier: Apache-2.0
"""Position of a ball of one colour in an image, by OpenCV.

The rays that touch a sphere make a cone about its middle: n · u = 1 for their directions u. So n,
by linear least squares, points to the middle, and its length tells the distance.
"""

from __future__ import annotations

import cv2
import numpy as np

from wam_power_ros.tracking.tag_detector import Pose

HUE_RANGE = 15.0  # [degrees] to either side
COLOUR_MIN = 40  # smallest difference of the largest and the smallest colour of a pixel
STRING = np.ones((5, 5), np.uint8)  # [px] what may hide a part, but not cut it in two
AREA_MIN = 25  # [px] of the ball
DIRECTIONS = 64  # points of the outline
REACH = 4.0  # how far beside it colours are looked at [px]
STEPS = 8  # of a pixel along a direction
STRAY = 3.0  # deviation from the cone of a point that is hidden, in medians
SHARE_MIN = 0.7  # of the outline that must be seen
ROUND = 0.05  # deviation from it of an outline that is round, as a share of its width


class BallDetector:
    """Finds the ball with this `radius` [m] and `hue` [degrees] in images."""

    def __init__(self, radius: float, hue: float) -> None:
        self._radius, self._hue = radius, hue

    def pose(self, stamp_ns: int, image: np.ndarray, k: np.ndarray, d: np.ndarray) -> Pose:
        """Position of the ball in the camera, and the identity, of an image (h, w, 3) in BGR.

        Raises:
            ValueError: The ball is not seen, or not whole.
        """
        if not image.size:
            raise ValueError("no image")
        colour = (image.max(axis=2) - image.min(axis=2)).astype(np.float32)
        pixels = _outline(colour, *self._spot(image, colour))
        rays = np.ones((len(pixels), 3))
        rays[:, :2] = cv2.undistortPoints(pixels[:, np.newaxis], k, d)[:, 0]
        rays /= np.linalg.norm(rays, axis=1)[:, np.newaxis]
        kept = np.full(len(rays), True)
        for _ in range(2):
            normal = np.linalg.lstsq(rays[kept], np.ones(kept.sum()), rcond=None)[0]
            off = np.abs(rays @ normal - 1.0)
            kept = off <= STRAY * np.median(off)
        length = float(np.linalg.norm(normal))
        width = 1.0 - 1.0 / length**2  # squared sine of half the angle of the cone
        if kept.sum() < SHARE_MIN * DIRECTIONS or np.median(off) > ROUND * width:
            raise ValueError("the outline is no ball's")
        return normal * (self._radius / np.sqrt(width) / length), np.eye(3)

    def _spot(self, image: np.ndarray, colour: np.ndarray) -> tuple[np.ndarray, float]:
        """Middle (2,) and about the radius [px] of the largest spot with the hue of the ball."""
        hue = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)[..., 0] * 2.0
        alike = np.abs((hue - self._hue + 180.0) % 360.0 - 180.0) < HUE_RANGE
        found = ((colour > COLOUR_MIN) & alike).astype(np.uint8)
        found = cv2.morphologyEx(found, cv2.MORPH_CLOSE, STRING)
        _, _, boxes, middles = cv2.connectedComponentsWithStats(found)
        areas = boxes[1:, cv2.CC_STAT_AREA]
        if not len(areas) or areas.max() < AREA_MIN:
            raise ValueError(f"no ball with a hue of {self._hue:g} degrees in view")
        return middles[1 + areas.argmax()], float(np.sqrt(areas.max() / np.pi))


def _outline(colour: np.ndarray, middle: np.ndarray, radius: float) -> np.ndarray:
    """Points (DIRECTIONS, 2) [px] around a spot at which its colour (h, w) falls."""
    reach = REACH + 0.25 * radius
    far = np.array([middle - radius - reach, colour.shape[::-1] - middle - radius - reach])
    if far.min() < 0.0:
        raise ValueError("the ball is at the edge of the image")
    angle = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    way = np.arange(max(radius - reach, 0.0), radius + reach, 1.0 / STEPS)
    points = (middle + along[:, np.newaxis] * way[:, np.newaxis]).astype(np.float32)
    strength = cv2.remap(colour, points[..., 0], points[..., 1], cv2.INTER_LINEAR)
    fall = strength[:, :-STEPS] - strength[:, STEPS:]  # over a pixel
    fall *= fall > 0.5 * fall.max(axis=1, keepdims=True)
    edge = fall @ (way[:-STEPS] + 0.5) / np.maximum(fall.sum(axis=1), 1e-6)
    outline: np.ndarray = middle + along * edge[:, np.newaxis]
    return outline
