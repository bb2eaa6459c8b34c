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
DELTA_H = 0.12  # larger than the pancake's radius, so that its edge is still above the pan [m]
# Standard deviation of the tracked centre along an axis [m]: 0.25 mm for four markers of 0.5 mm,
# and 0.25 mm for errors of the flight model.
POSITION_NOISE = 0.0005
TILT_NOISE = 0.0035  # standard deviation of the tracked normal about an axis [rad]
REST_WINDOW = 0.2  # time at the end of the path in which the end state is determined [s]
_RIM_HEIGHT = 0.03  # height above the floor up to which an edge may still slide on the pan [m]
REST_HEIGHT_MAX = 0.015  # largest height of the centre above the pan's floor at rest [m]
_REST_COSINE_MIN = 0.97  # smallest |n . n_pan| at rest [1]
_LEFT_HEIGHT = 0.12  # of a centre that has left the pan, above one on its edge at the rim [m]
_AGREED = 2 / 3  # share of the frames at rest that must show the same side up
_SAME_SIDE_COSINE = 0.5  # smallest one of the angle between two that do [1]
_THROUGH_MAX = 0.012  # depth of an edge below the floor that errors of frames explain [m]
_ODD_MAX = 0.1  # largest share of the frames in the pan that has one which is deeper
_ENOUGH = 3  # consecutive frames that tell a flight
_SAME_ANGLE_MAX = 0.1  # largest angle between body-frame normals of frames at rest [rad]


@dataclass(frozen=True, eq=False)
class Frames:
    """M frames of the pancake during the path of the pan; M may be 0."""

    t: np.ndarray  # time of each [s], shape (M,)
    position: np.ndarray  # centre of the pancake, base frame [m], shape (M, 3)
    normal: np.ndarray  # of it, base frame, shape (M, 3); zeros if it was never seen at rest
    normal_start: np.ndarray  # of the pan at the start, base frame, shape (3,)
    resting_frames: int  # number of those at rest that tell the body-frame normal
    above: np.ndarray  # height of the centre above the pan's [m], shape (M,)
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

    def flight(self) -> np.ndarray:
        """Indices of the consecutive frames in flight from which it falls through `DELTA_H`.

        They hold its highest one, unless it touched the rim in the air after that.
        """
        if not self.flying.any() or not self.resting_frames:
            return np.zeros(0, dtype=int)
        flying = np.flatnonzero(self.flying)
        top = flying[np.argmax(self.position[flying, 2])]
        low = np.append(top + np.flatnonzero(self.above[top:] < DELTA_H), len(self.t))[0]
        runs = np.split(flying, np.flatnonzero(np.diff(flying) > 1) + 1)
        runs = [run for run in runs if run[-1] >= top and run[0] <= max(top, low)]
        return next((run for run in reversed(runs) if len(run) >= _ENOUGH), runs[0])

    def contradicted(self, end: float) -> bool:
        """Whether orientations in the pan cannot be those of a disc that lies there.

        An edge would be below the floor in too many frames, or sides alternate at the end [s].
        """
        lying = (np.abs(self.height) < REST_HEIGHT_MAX) & (self.offset < PAN_RADIUS)
        edge = np.sqrt(1.0 - np.minimum(self.cosine**2, 1.0)) * PANCAKE_RADIUS
        through = edge - self.height > _THROUGH_MAX
        first = lying & ~np.maximum.accumulate(self.flying)
        last = lying & (self.t >= end - REST_WINDOW)
        odd = any(np.sum(through[part]) > _ODD_MAX * np.sum(part) for part in (first, last))
        over = np.sum(self.cosine[last] < 0.0)
        return odd or bool(min(over, np.sum(last) - over) > np.sum(last) / 3)


def frames_from_pan(
    pan: EndEffectorPath, pancake: BodyPath, before: BodyPath | None = None
) -> Frames:
    """Compute the pose of the pancake relative to the pan in every frame; gaps are allowed.

    Which side is up is taken from the frames `before` the start, at which the pan is at rest, else
    from the first ones before the pancake leaves it; never from those after its flight.
    """
    inside = (pancake.t >= pan.t[0]) & (pancake.t <= pan.t[-1])
    pancake = pancake.part(inside)
    t, position = pancake.t, pancake.position
    matrix = rotations.matrix(pancake.quat_xyzw)
    normal_of_pan = pan_normal(pan, t)
    relative, height, offset = _from_pan(pan, pancake, normal_of_pan)
    # Flat in the pan it shows the pan's normal in its own frame.
    body = _in_body(matrix, normal_of_pan)
    left = np.maximum.accumulate(height > _LEFT_HEIGHT) if len(t) else np.zeros(0, dtype=bool)
    flat = (np.abs(height) < REST_HEIGHT_MAX) & (offset < PAN_RADIUS)
    at_rest = body[:0]
    if before is not None:
        still = pan_normal(pan, before.t)
        _, above, aside = _from_pan(pan, before, still)
        lying = (np.abs(above) < REST_HEIGHT_MAX) & (aside < PAN_RADIUS)
        at_rest = _in_body(rotations.matrix(before.quat_xyzw), still)[lying]
    resting = _resting(at_rest, body[flat & ~left][:5], body[flat])
    normal = np.zeros((len(t), 3))
    if len(resting):
        normal = matrix @ unit(resting.mean(axis=0))
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
        above=relative[:, 2],
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


def _from_pan(
    pan: EndEffectorPath, pancake: BodyPath, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position from the pan's (M, 3), height along its `normal` (M, 3), and offset (M,) [m]."""
    relative = pancake.position - interpolate(pancake.t, pan.t, pan.position)
    height = np.sum(relative * normal, axis=1)
    return relative, height, np.linalg.norm(relative - height[:, None] * normal, axis=1)


def _in_body(matrix: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Normals (M, 3) in the frames (M, 3, 3) of the body. Shape (M, 3)."""
    return np.matmul(np.swapaxes(matrix, 1, 2), normal[:, :, None])[:, :, 0]


def _resting(before: np.ndarray, early: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Body-frame normals at rest: the first consecutive ones of `flat` (n, 3) that are the same.

    The side up is what most show `before` the start (m, 3), or if there is none, the `early` ones
    (k, 3), before the pancake leaves the pan; none if too few agree. Without an early one of that
    side, those before the start.
    """
    first = before if len(before) else early
    if not len(first) or np.mean(first @ _middle(first) > _SAME_SIDE_COSINE) < _AGREED:
        return first[:0]
    early = early[early @ _middle(first) > _SAME_SIDE_COSINE]
    if not len(early):
        return first[first @ _middle(first) > math.cos(_SAME_ANGLE_MAX)]
    same = flat @ _middle(early) > math.cos(_SAME_ANGLE_MAX)
    start = int(np.argmax(same))
    length = int(np.argmin(same[start:])) if not same[start:].all() else len(same) - start
    return flat[start : start + length]


def _middle(normals: np.ndarray) -> np.ndarray:
    """The one of some normals (n, 3) that is closest to the others: a bad one does no harm."""
    middle: np.ndarray = normals[int(np.argmax((normals @ normals.T).sum(axis=1)))]
    return middle
