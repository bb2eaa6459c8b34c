# SPDX-License-Identifier: Apache-2.0
"""Motion-capture frames of the pancake, seen from the pan: in flight, at rest, turned over."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath

PANCAKE_RADIUS = 0.09  # [m]
PAN_RADIUS = 0.139  # [m] of the pan's floor
# Of the tracked centre: 0.25 mm for four markers of 0.5 mm, as much again for the flight's model.
POSITION_NOISE = 0.0005  # [m]
TILT_NOISE = 0.0035  # [rad] of the tracked normal, each way
REST_WINDOW = 0.2  # [s] at the end of the path in which rest is looked for
_RIM_HEIGHT = 0.03  # [m] from the floor: below that an edge of the pancake may still slide on it
_REST_HEIGHT_MAX = 0.015  # [m] of the centre above the pan's floor at rest
_REST_COSINE_MIN = 0.97  # |n . n_pan| at rest
_ALIKE_ANGLE_MAX = 0.1  # [rad] between body-frame normals of frames at rest


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of the pancake within the pan's path; M may be 0.

    Attributes:
        t: Time of each frame [s]. Shape (M,).
        position: Centre of the pancake, base frame [m]. Shape (M, 3).
        normal: Normal of the pancake, base frame; zeros when it was never seen at rest.
            Shape (M, 3).
        normal_start: Normal of the pan at the start, base frame. Shape (3,).
        resting_frames: Number of frames at rest from which the body-frame normal was computed.
        height: Height of the centre above the pan's floor, along the pan's normal [m]. Shape (M,).
        aside: Distance of the centre from the pan's centre, along the floor [m]. Shape (M,).
        cosine: Pancake's normal . pan's normal. Shape (M,).
        flying: The lower edge is higher than the pan's rim. Shape (M,), bool.
    """

    t: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    normal_start: np.ndarray
    resting_frames: int
    height: np.ndarray
    aside: np.ndarray
    cosine: np.ndarray
    flying: np.ndarray

    def end_state(self, end: float) -> tuple[bool, bool]:
        """Whether the pancake rests in the pan at the end of the path, and whether turned over.

        Args:
            end: Time at which the pan's path ends [s].

        Returns:
            Resting, flipped; both False when no frame shows it.
        """
        last = self.t >= end - REST_WINDOW
        if not last.any() or not self.resting_frames:
            return False, False
        cosine = float(np.median(self.cosine[last]))
        resting = (
            abs(float(np.median(self.height[last]))) < _REST_HEIGHT_MAX
            and float(np.median(self.aside[last])) < PAN_RADIUS
            and abs(cosine) > _REST_COSINE_MIN
        )
        return resting, cosine < 0.0


def frames_from_pan(pan: EndEffectorPath, pancake: BodyPath) -> Frames:
    """Pose of the pancake relative to the pan, frame by frame.

    Args:
        pan: Path of the pan.
        pancake: Path of the pancake, same clock; gaps are allowed.
    """
    inside = (pancake.t >= pan.t[0]) & (pancake.t <= pan.t[-1])
    t, position = pancake.t[inside], pancake.position[inside]
    matrix = rotations.matrix(pancake.quat_xyzw[inside])
    normal_of_pan = pan_normal(pan, t)
    offset = position - interpolate(t, pan.t, pan.position)
    height = np.sum(offset * normal_of_pan, axis=1)
    aside = np.linalg.norm(offset - height[:, None] * normal_of_pan, axis=1)
    # The first frames show the pancake flat in the pan: their mean is the body-frame normal.
    body = np.matmul(np.swapaxes(matrix, 1, 2), normal_of_pan[:, :, None])[:, :, 0]  # (M, 3)
    flat = (np.abs(height) < _REST_HEIGHT_MAX) & (aside < PAN_RADIUS)
    resting = _first_alike(flat, body)
    normal = np.zeros((len(t), 3))
    if len(resting):
        normal = matrix @ unit(body[resting].mean(axis=0))
    cosine = np.sum(normal * normal_of_pan, axis=1)
    sine = np.sqrt(np.clip(1.0 - cosine**2, 0.0, 1.0))
    # Away from the pan its floor, extended, means nothing: there only the height counts.
    away = aside > PAN_RADIUS + 2.0 * PANCAKE_RADIUS
    gap = np.where(away, offset[:, 2] - PANCAKE_RADIUS, height - sine * PANCAKE_RADIUS)
    return Frames(
        t=t,
        position=position,
        normal=normal,
        normal_start=pan_normal(pan, pan.t[:1])[0],
        resting_frames=len(resting),
        height=height,
        aside=aside,
        cosine=cosine,
        flying=gap > _RIM_HEIGHT,
    )


def pan_normal(pan: EndEffectorPath, t: np.ndarray) -> np.ndarray:
    """Normal of the pan at times t (m,) [s], base frame. Shape (m, 3)."""
    quat = rotations.normalised(pan.quat_xyzw)
    return rotations.matrix(rotations.interpolate(t, pan.t, quat))[:, :, 2]


def interpolate(t: np.ndarray | float, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Linear interpolation between the rows of `values`. Shape (m, 3), or (3,) for one time."""
    return np.stack([np.interp(t, times, column) for column in values.T], axis=-1)


def unit(vector: np.ndarray) -> np.ndarray:
    """Vector of length 1 in the same direction; zeros stay zeros."""
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _first_alike(flat: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Indices of the first flat frames in a row with the same body-frame normal.

    Of the first five, the frame most like the others is the reference, so that one bad frame does
    no harm.
    """
    candidates = np.flatnonzero(flat)
    first = candidates[:5]
    if len(first) == 0:
        return first
    reference = body[first[int(np.argmax((body[first] @ body[first].T).sum(axis=1)))]]
    alike = body[candidates] @ reference > math.cos(_ALIKE_ANGLE_MAX)
    start = int(np.argmax(alike))
    length = int(np.argmin(alike[start:])) if not alike[start:].all() else len(alike) - start
    return candidates[start : start + length]
