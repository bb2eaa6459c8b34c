# SPDX-License-Identifier: Apache-2.0
"""Whether the body that the cameras show can be the pancake in this pan.

At rest it lies on the pan's floor, whose height is known, and has no room in the rim; then it moves
at least as far as the pan. Along the floor its place at rest is not known: an error of the cameras'
frame of a few centimetres shows in the height alone, which is corrected.
"""

from __future__ import annotations

import math

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.tasks.flip.frames import PAN_RADIUS

HEIGHT_OFF_MAX = 0.025  # largest error of the height at rest that is corrected [m]
# Largest distance from the pan's centre of one that lies flat, if it is as small as 0.07 m [m]
FLAT_OFFSET_MAX = PAN_RADIUS - 0.07
_HEIGHT = 0.0025  # of the centre at rest [m]
_HEIGHT_KNOWN = 0.006  # errors up to which it depends on the pancake and its markers [m]
_MOVED_MIN = 0.03  # movement of the pan that a pancake in it must follow [m]
_FOLLOWED_MIN = 0.5  # share of it by which it moves at least
_TURN_MIN = 0.1  # turn of the pan that a pancake in it must follow [rad]
_TURN_ALIKE = 0.15  # largest share by which the turn of one that lies in the pan differs
AXIS_OFF = math.radians(12.0)  # between the axes of both turns: tosses had up to 7 degrees
AXIS_OFF_IN_DOUBT = math.radians(4.0)  # and 1 degree in the median
_LEAVES = 0.01  # before the pan is seen fastest the pancake may have left it [s]
CAUSES = "a joint's zero, the mounting of the tool or the cameras' frame is wrong"
ONE_MARKER = (
    "the pancake's orientation is never measured, as of one marker, so a flip cannot be seen: give "
    "it a layout of three markers or more, and set single_marker: false"
)


def misplaced(in_pan: np.ndarray) -> str:
    """Why a pancake cannot rest at a place (3,) [m] in the pan's frame; "" if it can."""
    x, y, height = in_pan
    aside = math.hypot(x, y)
    measure = f"{CAUSES}; measure them with wam-power commission"
    if aside > PAN_RADIUS:
        return (
            f"the pancake is seen at rest at {x:.3f}, {y:.3f}, {height:.3f} m in the frame of the "
            f"pan, outside it: the markers are those of another body, or {measure}"
        )
    if abs(height - _HEIGHT) > HEIGHT_OFF_MAX:
        return (
            f"the pancake is seen at rest {height * 1e3:+.0f} mm from the pan's floor, where "
            f"nothing can hold it: {measure}"
        )
    if aside > FLAT_OFFSET_MAX and height < _HEIGHT + _HEIGHT_KNOWN:
        return (
            f"the pancake is seen flat {aside * 1e3:.0f} mm beside the middle of the pan, where "
            f"its edge would be in the rim: {measure}"
        )
    return ""


def doubt(pan: EndEffectorPath, pancake: BodyPath, before: BodyPath | None) -> str:
    """Why the body of a rollout cannot be the pancake in the pan; "" if it can."""
    parts = [part for part in (before, pancake) if part is not None]
    quat = np.concatenate([part.quat_xyzw for part in parts])
    place = np.concatenate([part.position for part in parts])
    if len(quat) > 2 and not np.ptp(quat, axis=0).any() and np.ptp(place, axis=0).all():
        return ONE_MARKER
    if before is None or not len(before.t):
        return ""
    rest, turn = np.median(before.position, axis=0), rotations.matrix(pan.quat_xyzw)
    if why := misplaced(turn[0].T @ (rest - pan.position[0])):
        return why
    moved = float(np.linalg.norm(pan.position - pan.position[0], axis=1).max())
    seen = float(np.linalg.norm(place - rest, axis=1).max())
    if moved > _MOVED_MIN and seen < _FOLLOWED_MIN * moved:
        return (
            f"the pan moved by {moved * 1e3:.0f} mm and what is seen as the pancake in it by "
            f"{seen * 1e3:.0f} mm: the markers are those of another body"
        )
    return ""


def turned(
    pan: EndEffectorPath, pancake: BodyPath, before: BodyPath | None, axis_off: float = AXIS_OFF
) -> str:
    """Why the cameras' frame must be turned against that of the arm; "" if it need not be.

    While the pan carries the pancake both turn about one axis, but for less than `axis_off` [rad].
    """
    if before is None or not len(before.t) or len(pan.t) < 2:
        return ""
    matrix = rotations.matrix(pan.quat_xyzw)
    height = np.sum(matrix[:, :, 2] * (pan.position - pan.position[0]), axis=1)
    carried = pancake.t < pan.t[int(np.argmax(np.gradient(height)))] - _LEAVES
    rows = np.minimum(np.searchsorted(pan.t, pancake.t[carried]), len(pan.t) - 1)
    turns = [rotations.log(matrix[row] @ matrix[0].T) for row in rows]
    if not turns or np.linalg.norm(turns, axis=1).max() < _TURN_MIN:
        return ""
    most = int(np.argmax(np.linalg.norm(turns, axis=1)))
    first = rotations.matrix(before.quat_xyzw[-1])
    seen = rotations.log(rotations.matrix(pancake.quat_xyzw[most]) @ first.T)
    size, wanted = float(np.linalg.norm(seen)), float(np.linalg.norm(turns[most]))
    if abs(size - wanted) > _TURN_ALIKE * wanted:
        return ""  # it slides or hops
    off = math.acos(min(float(seen @ turns[most]) / (size * wanted), 1.0))
    if off < axis_off:
        return ""
    return (
        f"the pancake turns with the pan about an axis {math.degrees(off):.0f} degrees off: the "
        "cameras' frame is turned; measure it with wam-power commission"
    )


def on_floor(
    pan: EndEffectorPath, pancake: BodyPath, before: BodyPath | None
) -> tuple[BodyPath, BodyPath | None, float]:
    """Frames from the start on and before it, moved so that they rest on the floor; by how much.

    The error [m] is 0 where it is too small to be one, or no frame shows the pancake at rest.
    """
    if before is None or not len(before.t):
        return pancake, before, 0.0
    normal = rotations.matrix(pan.quat_xyzw[:1])[0][:, 2]
    height = float(np.median((before.position - pan.position[0]) @ normal))
    off = height - _HEIGHT
    if abs(off) <= _HEIGHT_KNOWN:
        return pancake, before, 0.0
    moved = [
        BodyPath(part.id, part.t, part.position - off * normal, part.quat_xyzw)
        for part in (pancake, before)
    ]
    return moved[0], moved[1], off
