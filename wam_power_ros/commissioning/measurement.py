# SPDX-License-Identifier: Apache-2.0
"""What a recording of the movement in `excitation` tells about arm and cameras."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.commissioning import camera_frame, identification
from wam_power_ros.commissioning.camera_frame import CameraFrame, Pose
from wam_power_ros.commissioning.excitation import Excitation
from wam_power_ros.commissioning.identification import SETTLED, Identified
from wam_power_ros.control.arm import Arm

HELD_OUT = 4  # postures at the end that are not used, to check the result
UNUSED = -2 * HELD_OUT  # index of the first rest at them
ARRIVING = 0.5  # [s] before a rest that count as well in a check: more poses, less noise
FITTED_SWEEPS = 2  # the others check it
SEARCH_STEP = 0.05  # [s] of the search for the beginning of the movement
TRACKING_MAX = 0.2  # [rad] rms between movement and recording beyond which it is another one
LATENCY_STEPS = 5


@dataclass(frozen=True, eq=False)
class Recording:
    """States, commands and poses of a body on the tool, of one recording."""

    t: np.ndarray  # times of the states [s] (M,)
    q: np.ndarray  # reported positions [rad] (M, n)
    tau: np.ndarray  # commanded torques, without gravity if the driver adds it [N m] (M, n)
    seen_t: np.ndarray  # times of the poses [s] (P,)
    position: np.ndarray  # of the body, in the frame that is taken for the base's [m] (P, 3)
    rotation: np.ndarray  # its orientation (P, 3, 3)


@dataclass(frozen=True)
class Residual:
    """Torque that a model does not explain, root mean square over joints and samples [N m]."""

    rest: float  # the mean of both sides
    slow: float  # in a slow movement
    fast: float  # in a faster one


@dataclass(frozen=True, eq=False)
class Seen:
    """What the cameras tell."""

    frame: CameraFrame
    not_visible: tuple[int, ...]  # numbers of the rests at which the body was not seen, from 0
    latency: float  # by which the poses' stamps are late, beyond what is known [s]
    latency_change: float  # by how much more they are late in the last sweep [s]
    fit_position: float  # mean error of the body at a rest that was used, largest [m]
    fit_rotation: float  # the same [rad]
    check_position: float  # at a rest that was not used [m]
    check_rotation: float  # [rad]
    sweep_position: float  # in a sweep, root mean square, largest of all sweeps [m]
    sweep_rotation: float  # [rad]


@dataclass(frozen=True, eq=False)
class Commissioned:
    """Result of `analyse`."""

    cameras: Seen | None  # None if they saw no body
    arm: Identified
    before: Residual  # in movements not used, by the model of the URDF
    after: Residual  # by that with the corrections


def analyse(
    arm: Arm,
    plan: Excitation,
    recorded: Recording,
    payload: float | None = None,
    gravity_added: bool = False,
    flat: bool = False,
) -> Commissioned:
    """Find what differs from the URDF, and check it on postures and sweeps that were not used.

    Args:
        arm: Arm as its URDF describes it, without corrections; its buffers are used.
        payload: Mass of the tool beyond the URDF's, from a scale [kg]; None if it was not weighed.
        gravity_added: Whether the driver adds gravity by a model of its own, which is taken for the
            URDF's.
        flat: Whether the body lies flat in the tool, see `camera_frame.calibrate`.

    Raises:
        ValueError: The recording is of another movement, or what the cameras saw is not usable.
    """
    if gravity_added:
        carried = np.array([arm.gravity(each) for each in recorded.q])
        recorded = replace(recorded, tau=recorded.tau + carried)
    start = begun(plan, recorded.t, recorded.q)
    recorded = replace(recorded, t=recorded.t - start, seen_t=recorded.seen_t - start)
    cameras = _seen(arm, plan, recorded, flat) if len(recorded.seen_t) else None
    zeros = np.zeros(arm.n) if cameras is None else cameras.frame.zeros
    fitted = Excitation(plan.t, plan.q, plan.rests[:UNUSED], plan.sweeps[:FITTED_SWEEPS])
    states = recorded.t, recorded.q, recorded.tau
    found = identification.identify(arm, fitted, *states, zeros, payload)
    return Commissioned(
        *(cameras, found),
        before=_residual(arm, plan, recorded, found.loop_delay),
        after=_residual(arm.corrected(found.corrections), plan, recorded, found.loop_delay),
    )


def begun(plan: Excitation, t: np.ndarray, q: np.ndarray) -> float:
    """Time [s] at which a movement begins in a recording of states t (M,) [s] and q (M, n) [rad].

    Raises:
        ValueError: The recording is too short, or of another movement.
    """
    room = float(t[-1] - t[0] - plan.t[-1])
    if room < 0.0:
        short = f"the recording has {t[-1] - t[0]:.0f} s of a movement of {plan.t[-1]:.0f} s"
        raise ValueError(f"{short}: it was ended early")

    def error(start: float) -> float:
        reached = np.stack([np.interp(start + plan.t[::10], t, column) for column in q.T], axis=1)
        return float(np.sqrt(np.mean((reached - plan.q[::10]) ** 2)))

    step, best = SEARCH_STEP, float(t[0])
    starts: np.ndarray = best + np.arange(0.0, room + step, step)
    while step > 5e-4:
        best = float(starts[np.argmin([error(start) for start in starts])])
        step /= 5.0
        starts = best + step * np.arange(-5, 6)
    if error(best) > TRACKING_MAX:
        raise ValueError(f"the arm was {error(best):.2f} rad (rms) from the movement: another one")
    return best


def _seen(arm: Arm, plan: Excitation, recorded: Recording, flat: bool) -> Seen:
    """What the cameras tell; the times of the recording are those of the movement."""
    rests = [(end - SETTLED, end) for _, end in plan.rests]
    seen = np.diff(np.searchsorted(recorded.seen_t, rests))[:, 0] >= 2  # frames
    numbers = np.flatnonzero(seen[:UNUSED])
    if not len(numbers):
        raise ValueError("the cameras saw the body at none of the rests")
    q, position, rotation = _at_rest(recorded, [rests[k] for k in numbers])
    frame = camera_frame.calibrate(arm, q, position, rotation, flat)
    frame = replace(frame, rejected=tuple(int(numbers[row]) for row in frame.rejected))
    first, last = (_latency(arm, frame, recorded, plan.sweeps[k]) for k in (FITTED_SWEEPS - 1, -1))
    timed = replace(recorded, seen_t=recorded.seen_t - first)
    parts = plan.rests - [ARRIVING, 0.0]
    groups = np.delete(parts[:UNUSED], frame.rejected, axis=0), parts[UNUSED:]
    apart = [_apart(arm, frame, timed, group).max(axis=0) for group in groups]
    for begin, end in plan.sweeps:
        parts = np.arange(begin, end - SETTLED, SETTLED)[:, None] + [0.0, SETTLED]
        apart.append(_apart(arm, frame, timed, parts).mean(axis=0))
    fit, check, *swept = np.sqrt(np.maximum(apart, 0.0)).tolist()
    not_visible = tuple(np.flatnonzero(~seen).tolist())
    worst = np.max(swept, axis=0).tolist()
    return Seen(frame, not_visible, first, last - first, *fit, *check, *worst)


def _at_rest(recorded: Recording, rests: list[tuple[float, float]]) -> Iterator[np.ndarray]:
    """Mean positions of the joints, mean positions and mean orientations of the body at rests."""
    rows = []
    for between in rests:
        states = slice(*np.searchsorted(recorded.t, between).tolist())
        frames = slice(*np.searchsorted(recorded.seen_t, between).tolist())
        turns = recorded.rotation[frames]
        offsets = rotations.log(turns @ turns[0].T).mean(axis=0)
        mean = recorded.position[frames].mean(axis=0), rotations.exp(offsets) @ turns[0]
        rows.append((recorded.q[states].mean(axis=0), *mean))
    return (np.array(column) for column in zip(*rows, strict=True))


def _apart(arm: Arm, cameras: CameraFrame, recorded: Recording, parts: np.ndarray) -> np.ndarray:
    """Mean errors of the body's position [m] and orientation [rad] in parts, squared.

    The poses of the recording have the times of their exposure; `parts` (N, 2) are the begin and
    end of each [s]. The square that noise of the cameras alone would leave is taken off. Parts in
    which the body was not seen are left out; one row of NaN is left if that is all. Shape (N, 2).
    """
    q = np.stack([np.interp(recorded.seen_t, recorded.t, column) for column in recorded.q.T], 1)
    rows = []
    for between in parts:
        frames = range(*np.searchsorted(recorded.seen_t, between).tolist())
        poses = (Pose(recorded.position[k], recorded.rotation[k]) for k in frames)
        errors = [_error(arm, cameras, q[k], pose) for k, pose in zip(frames, poses, strict=True)]
        if len(errors) > 1:
            noise = np.var(errors, axis=0, ddof=1) / len(errors)
            rows.append((np.mean(errors, axis=0) ** 2 - noise).sum(axis=1))
    return np.array(rows) if rows else np.full((1, 2), np.nan)


def _error(arm: Arm, cameras: CameraFrame, q: np.ndarray, seen: Pose) -> np.ndarray:
    """Error of the body's position [m] and orientation [rad]. Shape (2, 3)."""
    expected, base = _body(arm, cameras, q), cameras.world_to_base
    turned = expected.rotation.T @ base.rotation @ seen.rotation
    place = base.rotation @ seen.position + base.position
    return np.stack([place - expected.position, rotations.log(turned)])


def _body(arm: Arm, cameras: CameraFrame, q: np.ndarray) -> Pose:
    """Pose of the body in the base at reported positions of the joints."""
    position, axes = arm.tool_pose(q - cameras.zeros)
    mounted = cameras.body_in_tool
    return Pose(position + axes @ mounted.position, axes @ mounted.rotation)


def _latency(arm: Arm, cameras: CameraFrame, recorded: Recording, between: np.ndarray) -> float:
    """Time by which stamps of poses are late [s]: that which makes the motions agree best.

    NaN if the cameras did not see the body.
    """
    t, seen_t = recorded.t, recorded.seen_t
    frames = slice(*np.searchsorted(seen_t, between).tolist())
    if frames.stop == frames.start:
        return math.nan
    states = slice(*np.searchsorted(t, between + np.array([-0.2, 0.2])).tolist())
    times, path = t[states], [_body(arm, cameras, q).position for q in recorded.q[states]]
    turn, offset = cameras.world_to_base.rotation, cameras.world_to_base.position
    seen = recorded.position[frames] @ turn.T + offset
    reached = np.array(path)
    speeds = np.gradient(reached, times, axis=0)

    def at(columns: np.ndarray, when: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(when, times, column) for column in columns.T], axis=1)

    late = 0.0
    for _ in range(LATENCY_STEPS):
        when = seen_t[frames] - late
        velocity = at(speeds, when)
        late += float((velocity * (at(reached, when) - seen)).sum() / (velocity**2).sum())
    return late


def _residual(arm: Arm, plan: Excitation, recorded: Recording, delay: float) -> Residual:
    """Unexplained torque in the rests and sweeps that were not used."""
    t, q, tau = recorded.t, recorded.q, recorded.tau
    parts = [identification.rests(t, q, tau, plan.rests[UNUSED:])]
    sweeps = plan.sweeps[FITTED_SWEEPS:]
    parts += [identification.sweep(t, q, tau, between, delay) for between in sweeps]
    sizes = []
    for part in parts:
        left = identification.residual(arm, part)[part.used]
        sizes.append(float(np.sqrt(np.mean(left**2))))
    return Residual(*sizes)
