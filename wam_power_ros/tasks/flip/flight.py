# SPDX-License-Identifier: Apache-2.0
"""Free flight of the pancake, estimated from motion-capture frames.

At 30 frames/s the pancake falls 7-10 cm and turns 20 degrees from one frame to the next, so the
nearest frame is a poor measurement at the time t_f at which it passes Delta_h above the pan
(Eq. 5). Free flight has few unknowns: position, velocity and a small drag; normal, angular velocity
and a small decay. They are fitted to all frames of the flight and evaluated at t_f, where the
fitted height crosses the height of the pan plus Delta_h.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.tasks.flip.ballistic_fit import Arc, Crossing, find_crossing, fit_arc
from wam_power_ros.tasks.flip.frames import (
    DELTA_H,
    REST_WINDOW,
    Frames,
    frames_from_pan,
    interpolate,
    pan_normal,
    pitch_of,
)
from wam_power_ros.tasks.flip.spin_fit import Spin, angle_between, fit_spin

UNKNOWN_SIDE = (
    "the pancake was not seen at rest in the pan before it left it, so which side was up is unknown"
)
ORIENTATION_JUMPS = "the orientation of the pancake jumps, so how far it turned is unknown"
_NORMAL_ERROR_MAX = 0.35  # largest angle of a frame's normal from the fitted spin [rad]
_ODD_FRAMES_MAX = 0.3  # largest share of frames that say otherwise than most
_RELEASE_ANGLE_MAX = 1.25  # largest angle of the spin's normal from the pan's at release [rad]
_POSITION_STD_MAX = 0.1  # with a larger one at t_f the pancake counts as lost from view [m]


@dataclass(frozen=True, eq=False)
class Flight:
    """Observed toss, in the base frame. Every number is finite."""

    tossed: bool  # whether it rose above the pan by more than Delta_h
    seen: bool  # whether its position at t_f is known
    # When it falls through the pan's height + Delta_h [s]; the end of the path if not tossed
    t_f: float
    position: np.ndarray  # of its centre at t_f, the last known one if not seen [m], shape (3,)
    pan_position: np.ndarray  # of the pan at t_f [m], shape (3,)
    normal_start: np.ndarray  # v0, that of the pan at the start, shape (3,)
    # What follows is at t_f; if not tossed, at its highest point above the pan.
    normal: np.ndarray  # v_tf, shape (3,)
    # Rotation since it rested, in the plane normal to the spin axis [rad]. Of a toss in one plane,
    # arccos(v0 . v_tf) unfolded by the number of half turns. Of one not tossed, only the share of
    # Delta_h that it rose: what tilts with the pan has not turned.
    angle: float
    apex: float  # highest point above the pan's height at the start [m]
    # Pancake minus pan [m], shape (3,), of which the horizontal part matters; 0 if not seen
    landing_error: np.ndarray
    resting: bool  # whether it lies flat in the pan at the end of the path
    flipped: bool  # whether its normal is opposite to the pan's then
    climb: float = 0.0  # see `Frames.climb` [m]; 0 if not tossed
    catch_pitch: float = 0.0  # of the pan, positive with its front edge up [rad]


def observe_flight(
    pan: EndEffectorPath, pancake: BodyPath, before: BodyPath | None = None
) -> tuple[Flight, str]:
    """Estimate the flight of the pancake from the paths of pan and pancake of a rollout.

    The body-frame normal of the pancake is taken from the pan's normal while the pancake rests in
    the pan, `before` the start and until it leaves, so it does not depend on the axes chosen in the
    motion capture. The paper does not define the following cases: of several crossings, the first
    downward one after the apex counts; if it never rises above the height, `tossed` is False and
    t_f the end of the path; with too few frames, `seen` is False.

    Returns:
        The flight, and why its rotation or its end is not known; "" if they are.
    """
    frames = frames_from_pan(pan, pancake, before)
    if not frames.resting_frames:
        return _flight_without_arc(pan, frames), UNKNOWN_SIDE
    arc = fit_arc(frames)
    crossing = find_crossing(arc, pan, DELTA_H) if arc is not None else None
    if arc is None or crossing is None:
        return _flight_without_arc(pan, frames), _doubt(pan, frames)
    spin = fit_spin(frames, arc, pan)
    return _flight_on_arc(pan, frames, spin, crossing), _doubt(pan, frames, arc, spin)


def _doubt(
    pan: EndEffectorPath, frames: Frames, arc: Arc | None = None, spin: Spin | None = None
) -> str:
    """Why the orientations of the frames do not tell rotation or end; "" if they do."""
    if arc is not None and spin is not None:
        fitted = spin.normal(arc.t)
        off = [angle_between(*pair) for pair in zip(fitted, frames.normal[arc.used], strict=True)]
        frozen = np.all(np.diff(frames.normal[arc.used], axis=0) == 0.0, axis=1).any()  # no noise
        if frozen or np.mean(np.array(off) > _NORMAL_ERROR_MAX) > _ODD_FRAMES_MAX:
            return ORIENTATION_JUMPS
        left = pan_normal(pan, np.array([spin.release]))[0]
        if angle_between(left, spin.normal(np.array([spin.release]))[0]) > _RELEASE_ANGLE_MAX:
            return ORIENTATION_JUMPS
    return ORIENTATION_JUMPS if frames.contradicted(float(pan.t[-1])) else ""


def _flight_on_arc(pan: EndEffectorPath, frames: Frames, spin: Spin, crossing: Crossing) -> Flight:
    """Flight with a known crossing."""
    pan_position = interpolate(crossing.t, pan.t, pan.position)
    seen = crossing.position_std <= _POSITION_STD_MAX
    resting, flipped = frames.end_state(pan.t[-1])
    highest = max(crossing.apex, frames.position[:, 2].max())
    return Flight(
        tossed=True,
        seen=seen,
        t_f=crossing.t,
        position=crossing.position if seen else frames.position[-1],
        pan_position=pan_position,
        normal_start=frames.normal_start,
        normal=spin.normal(np.array([crossing.t]))[0],
        angle=spin.turned(frames.normal_start, crossing.t),
        apex=float(highest - pan.position[0, 2]),
        landing_error=crossing.position - pan_position if seen else np.zeros(3),
        resting=resting,
        flipped=flipped,
        climb=frames.climb(crossing.t),
        catch_pitch=pitch_of(pan_normal(pan, np.array([crossing.t])))[0],
    )


def _flight_without_arc(pan: EndEffectorPath, frames: Frames) -> Flight:
    """Flight of a pancake that was not tossed, or has too few frames in flight to fit an arc."""
    end = float(pan.t[-1])
    last_pan = pan.position[-1]
    resting, flipped = frames.end_state(end)
    above = frames.above
    tossed = bool(np.any(frames.flying & (above > DELTA_H)))
    normal, angle, error, pitch = frames.normal_start, 0.0, np.zeros(3), 0.0
    if len(frames.t) and frames.resting_frames:
        highest = int(np.argmax(np.where(frames.flying, above, -np.inf) if tossed else above))
        normal, t = frames.normal[highest], frames.t[highest : highest + 1]
        share = float(np.clip(above[highest] / DELTA_H, 0.0, 1.0))
        angle = share * angle_between(frames.normal_start, normal)
        error = frames.position[highest] - interpolate(t, pan.t, pan.position)[0]
        pitch = pitch_of(pan_normal(pan, t))[0]
    seen = not tossed and bool(len(frames.t)) and bool(end - frames.t[-1] <= REST_WINDOW)
    return Flight(
        tossed=tossed,
        seen=seen,
        t_f=end,
        position=frames.position[-1] if len(frames.t) else last_pan,
        pan_position=last_pan,
        normal_start=frames.normal_start,
        normal=normal,
        angle=angle,
        apex=float(frames.position[:, 2].max() - pan.position[0, 2]) if len(frames.t) else 0.0,
        landing_error=error if seen else np.zeros(3),
        resting=resting,
        flipped=flipped,
        catch_pitch=pitch,
    )
