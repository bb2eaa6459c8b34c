# SPDX-License-Identifier: Apache-2.0
"""Motion-capture frames of the pancake relative to the pan: in flight, at rest, flipped."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath

PANCAKE_RADIUS = 0.09  # [m]
PAN_RADIUS = 0.139  # radius of the pan's floor [m]
# Standard deviation of the tracked centre along an axis [m]: 0.25 mm for four markers of 0.5 mm,
# and 0.25 mm for errors of the flight model.
POSITION_NOISE = 0.0005
TILT_NOISE = 0.0035  # standard deviation of the tracked normal about an axis [rad]
REST_WINDOW = 0.2  # time at the end of the path in which the end state is determined [s]
_RIM_HEIGHT = 0.03  # height above the floor up to which an edge may still slide on the pan [m]
REST_HEIGHT_MAX = 0.015  # largest height of the centre above the pan's floor at rest [m]
_REST_COSINE_MIN = 0.97  # smallest |n . n_pan| at rest [1]
_SAME_ANGLE_MAX = 0.1  # largest angle between body-frame normals of frames at rest [rad]


@dataclass(frozen=True, eq=False)
class Frames:
    """M frames of the pancake during the path of the pan; M may be 0."""

    t: np.ndarray  # time of each [s], shape (M,)
    position: np.ndarray  # centre of the pancake, base frame [m], shape (M, 3)
    normal: np.ndarray  # of it, base frame, shape (M, 3); zeros if it was never seen at rest
    normal_start: np.ndarray  # of the pan at the start, base frame, shape (3,)
    resting_frames: int  # number of those at rest that tell the body-frame normal
    height: np.ndarray  # of the centre above the pan's floor, along its normal [m], shape (M,)
    offset: np.ndarray  # of the centre from the pan's, along the floor [m], shape (M,)
    cosine: np.ndarray  # of the angle between the normals of pancake and pan [1], shape (M,)
    flying: np.ndarray  # whether the lower edge is higher than the pan's rim, shape (M,)

    def climb(self, start: float) -> float:
        """Largest height above the floor after a fall from `start` [s], at the rim or in a bounce.

        Counts once its centre has been as low as at rest [m]; 0 if it never was.
        """
        low = np.flatnonzero((self.t > start) & (np.abs(self.height) < REST_HEIGHT_MAX))
        return float(self.height[low[0] :].max()) if len(low) else 0.0

    def end_state(self, end: float) -> tuple[bool, bool]:
        """Whether it rests in the pan at the end of the pan's path [s], and whether it is flipped.

        Both are False if no frame shows it.
        """
        last = self.t >= end - REST_WINDOW
        if not last.any() or not self.resting_frames:
            return False, False
        cosine = float(np.median(self.cosine[last]))
        resting = (
            abs(float(np.median(self.height[last]))) < REST_HEIGHT_MAX
            and float(np.median(self.offset[last])) < PAN_RADIUS
            and abs(cosine) > _REST_COSINE_MIN
        )
        return resting, cosine < 0.0


def frames_from_pan(pan: EndEffectorPath, pancake: BodyPath) -> Frames:
    """Compute the pose of the pancake relative to the pan in every frame; gaps are allowed."""
    inside = (pancake.t >= pan.t[0]) & (pancake.t <= pan.t[-1])
    t, position = pancake.t[inside], pancake.position[inside]
    matrix = rotations.matrix(pancake.quat_xyzw[inside])
    normal_of_pan = pan_normal(pan, t)
    relative = position - interpolate(t, pan.t, pan.position)
    height = np.sum(relative * normal_of_pan, axis=1)
    offset = np.linalg.norm(relative - height[:, None] * normal_of_pan, axis=1)
    # In the first frames the pancake lies flat in the pan: they give the body-frame normal.
    body = np.matmul(np.swapaxes(matrix, 1, 2), normal_of_pan[:, :, None])[:, :, 0]  # (M, 3)
    flat = (np.abs(height) < REST_HEIGHT_MAX) & (offset < PAN_RADIUS)
    resting = _first_resting(flat, body)
    normal = np.zeros((len(t), 3))
    if len(resting):
        normal = matrix @ unit(body[resting].mean(axis=0))
    cosine = np.sum(normal * normal_of_pan, axis=1)
    sine = np.sqrt(np.clip(1.0 - cosine**2, 0.0, 1.0))
    # Beside the pan, the plane of its floor is meaningless and only the height counts.
    beside = offset > PAN_RADIUS + 2.0 * PANCAKE_RADIUS
    gap = np.where(beside, relative[:, 2] - PANCAKE_RADIUS, height - sine * PANCAKE_RADIUS)
    return Frames(
        t=t,
        position=position,
        normal=normal,
        normal_start=pan_normal(pan, pan.t[:1])[0],
        resting_frames=len(resting),
        height=height,
        offset=offset,
        cosine=cosine,
        flying=gap > _RIM_HEIGHT,
    )


def pan_normal(pan: EndEffectorPath, t: np.ndarray) -> np.ndarray:
    """Normal of the pan at times t (m,) [s], base frame. Shape (m, 3)."""
    quat = rotations.normalised(pan.quat_xyzw)
    return rotations.matrix(rotations.interpolate(t, pan.t, quat))[:, :, 2]


def pitch_of(normal: np.ndarray) -> np.ndarray:
    """Pitch of a pan with these normals (m, 3), positive with its front up [rad]. Shape (m,)."""
    return np.arctan2(-normal[:, 0], normal[:, 2])


def interpolate(t: np.ndarray | float, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate linearly between the rows of `values`. Shape (m, 3), or (3,) for one time."""
    return np.stack([np.interp(t, times, column) for column in values.T], axis=-1)


def unit(vector: np.ndarray) -> np.ndarray:
    """Scale a vector to unit length; a zero vector stays zero."""
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _first_resting(flat: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Indices of the first consecutive flat frames with the same body-frame normal.

    The reference is the one of the first five frames that is closest to the others, so that one bad
    frame does no harm.
    """
    candidates = np.flatnonzero(flat)
    first = candidates[:5]
    if len(first) == 0:
        return first
    reference = body[first[int(np.argmax((body[first] @ body[first].T).sum(axis=1)))]]
    same = body[candidates] @ reference > math.cos(_SAME_ANGLE_MAX)
    start = int(np.argmax(same))
    length = int(np.argmin(same[start:])) if not same[start:].all() else len(same) - start
    return candidates[start : start + length]
