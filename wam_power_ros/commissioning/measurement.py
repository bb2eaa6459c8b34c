# SPDX-License-Identifier: Apache-2.0
"""What a recording of the movement in `excitation` tells about arm and cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.commissioning import camera_frame, identification
from wam_power_ros.commissioning.camera_frame import CameraFrame, Pose
from wam_power_ros.commissioning.excitation import Excitation
from wam_power_ros.commissioning.identification import Identified
from wam_power_ros.control.arm import Arm

HELD_OUT = 4  # postures at the end that are not used, to check the result
FITTED_SWEEPS = 2  # the others check it
SEARCH_STEP = 0.05  # [s] of the search for the beginning of the movement
TRACKING_MAX = 0.2  # [rad] rms between movement and recording beyond which it is another one
LATENCY_STEPS = 5


@dataclass(frozen=True, eq=False)
class Recording:
    """States, commands and poses of a body on the tool, of one recording.

    Attributes:
        t: Times of the states [s]. Shape (M,).
        q: Reported positions [rad]. Shape (M, n).
        tau: Commanded torques, without gravity if the driver adds it [N m]. Shape (M, n).
        seen_t: Times of the poses [s]. Shape (P,).
        position: Position of the body in the frame that is taken for the base's [m]. Shape (P, 3).
        rotation: Its orientation. Shape (P, 3, 3).
    """

    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    seen_t: np.ndarray
    position: np.ndarray
    rotation: np.ndarray


@dataclass(frozen=True)
class Residual:
    """Torque that a model does not explain, root mean square over joints and samples [N m].

    Attributes:
        rest: At rest, the mean of both sides.
        slow: In a slow movement.
        fast: In a faster one.
    """

    rest: float
    slow: float
    fast: float


@dataclass(frozen=True, eq=False)
class Commissioned:
    """Result of `analyse`.

    Attributes:
        cameras: Frame, body and zeros from the cameras; None if they saw no body.
        latency: Time by which the poses' stamps are late, beyond what is known [s].
        check_position: Error of the body at postures that were not used, largest [m].
        check_rotation: The same [rad].
        arm: Corrections of the arm.
        before: Torque that the model of the URDF leaves unexplained in movements not used.
        after: The same with the corrections.
    """

    cameras: CameraFrame | None
    latency: float
    check_position: float
    check_rotation: float
    arm: Identified
    before: Residual
    after: Residual


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
        plan: The movement.
        recorded: Recording of it.
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
    t = recorded.t - begun(plan, recorded.t, recorded.q)
    seen_t = recorded.seen_t - (recorded.t[0] - t[0])
    cameras, latency = None, 0.0
    check = (0.0, 0.0)
    zeros = np.zeros(arm.n)
    used, last = plan.rests[: -2 * HELD_OUT], plan.rests[-2 * HELD_OUT :]
    if len(seen_t):
        q, poses = _at_rest(t, recorded, seen_t, used)
        cameras = camera_frame.calibrate(arm, q, *poses, flat)
        zeros = cameras.zeros
        check = _error(arm, cameras, *_at_rest(t, recorded, seen_t, last))
        latency = _latency(arm, cameras, t, recorded, seen_t, plan.sweeps[FITTED_SWEEPS - 1])
    fitted = Excitation(plan.t, plan.q, used, plan.sweeps[:FITTED_SWEEPS])
    found = identification.identify(arm, fitted, t, recorded.q, recorded.tau, zeros, payload)
    return Commissioned(
        *(cameras, latency, *check, found),
        before=_residual(arm, plan, t, recorded, found.loop_delay),
        after=_residual(arm.corrected(found.corrections), plan, t, recorded, found.loop_delay),
    )


def begun(plan: Excitation, t: np.ndarray, q: np.ndarray) -> float:
    """Time at which a movement begins in a recording [s].

    Args:
        plan: The movement.
        t: Times of the states [s]. Shape (M,).
        q: Positions [rad]. Shape (M, n).

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


def _at_rest(
    t: np.ndarray, recorded: Recording, seen_t: np.ndarray, planned: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Mean positions of the joints and mean poses of the body at rests in which it was seen."""
    rows = []
    for _, end in planned:
        between = (end - identification.SETTLED, end)
        states = slice(*np.searchsorted(t, between).tolist())
        frames = slice(*np.searchsorted(seen_t, between).tolist())
        if frames.stop - frames.start < 2:
            continue
        turns = recorded.rotation[frames]
        offsets = rotations.log(turns @ turns[0].T).mean(axis=0)
        mean = recorded.position[frames].mean(axis=0), rotations.exp(offsets) @ turns[0]
        rows.append((recorded.q[states].mean(axis=0), *mean))
    if not rows:
        raise ValueError("the cameras saw the body at none of the rests")
    q, position, rotation = (np.array(column) for column in zip(*rows, strict=True))
    return q, (position, rotation)


def _error(
    arm: Arm, cameras: CameraFrame, q: np.ndarray, poses: tuple[np.ndarray, np.ndarray]
) -> tuple[float, float]:
    """Largest error of the body's position [m] and orientation [rad] at some postures."""
    apart, turned = [], []
    for posture, position, rotation in zip(q, *poses, strict=True):
        expected = _body(arm, cameras, posture)
        seen = _in_base(cameras, position, rotation)
        apart.append(float(np.linalg.norm(seen.position - expected.position)))
        turned.append(float(np.linalg.norm(rotations.log(expected.rotation.T @ seen.rotation))))
    return max(apart), max(turned)


def _body(arm: Arm, cameras: CameraFrame, q: np.ndarray) -> Pose:
    """Pose of the body in the base at reported positions of the joints."""
    position, axes = arm.tool_pose(q - cameras.zeros)
    mounted = cameras.body_in_tool
    return Pose(position + axes @ mounted.position, axes @ mounted.rotation)


def _in_base(cameras: CameraFrame, position: np.ndarray, rotation: np.ndarray) -> Pose:
    turn, offset = cameras.world_to_base.rotation, cameras.world_to_base.position
    return Pose(turn @ position + offset, turn @ rotation)


def _latency(
    arm: Arm,
    cameras: CameraFrame,
    t: np.ndarray,
    recorded: Recording,
    seen_t: np.ndarray,
    between: np.ndarray,
) -> float:
    """Time by which stamps of poses are late [s]: that which makes the motions agree best."""
    frames = slice(*np.searchsorted(seen_t, between).tolist())
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


def _residual(
    arm: Arm,
    plan: Excitation,
    t: np.ndarray,
    recorded: Recording,
    delay: float,
) -> Residual:
    """Unexplained torque in the rests and sweeps that were not used."""
    q, tau = recorded.q, recorded.tau
    parts = [identification.rests(t, q, tau, plan.rests[-2 * HELD_OUT :])]
    sweeps = plan.sweeps[FITTED_SWEEPS:]
    parts += [identification.sweep(t, q, tau, between, delay) for between in sweeps]
    sizes = []
    for part in parts:
        left = identification.residual(arm, part)[part.used]
        sizes.append(float(np.sqrt(np.mean(left**2))))
    return Residual(*sizes)
