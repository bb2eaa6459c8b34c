# SPDX-License-Identifier: Apache-2.0
"""Rows about motion capture: what the tracker makes of its frames, latency, which way is up.

The frames go through the tracker itself, so what is told here is what it will do. That a body falls
along gravity is the one thing that shows a wrong axis or frame beyond doubt.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.conformance.topic_checks import PAIR, Row, Verdict
from wam_power_ros.learning.rollout import BodyPath
from wam_power_ros.tracking import marker_fit
from wam_power_ros.tracking.tracker import (
    FROZEN_COUNT,
    FROZEN_TIME,
    Y_UP,
    Tracker,
    TrackerSettings,
    falling,
)

USABLE = 0.9  # share of frames that the tracker must take
RECEIPT = 0.003  # [s] after which a frame cannot have been exposed, sent and received
AWRY = (0.985, 0.87)  # cosine of a fall to the vertical that is worth a word, and that is wrong
IN_THE_PAN = 0.1  # [m] from the pan's floor, within which the learner takes the pancake to rest


class FrameSample(NamedTuple):
    """One pose as it came, in the frame of the motion capture."""

    received_ns: int
    stamp_ns: int
    position: np.ndarray  # (3,)
    quat_xyzw: np.ndarray  # (4,)


class CloudSample(NamedTuple):
    """One cloud of markers as it came."""

    received_ns: int
    stamp_ns: int
    points: np.ndarray  # (m, 3)


def poses(clouds: Sequence[CloudSample]) -> tuple[list[FrameSample], Row]:
    """Frames of the layout in clouds of markers, and the row about how clear it is in them."""
    expected = f"the {len(marker_fit.LAYOUT)} markers of the layout in every cloud"
    frames, errors = [], []
    for cloud in clouds:
        try:
            found = marker_fit.fit(cloud.points)
        except ValueError:
            continue
        errors.append(found.rms)
        frames.append(FrameSample(*cloud[:2], found.position, found.quat_xyzw))
    if not clouds:
        return [], Row("mocap markers", expected, "no cloud", Verdict.UNCHECKED)
    counts = [len(cloud.points) for cloud in clouds]
    share = len(frames) / len(clouds)
    text = f"{min(counts)} to {max(counts)} points, layout found in {share:.0%}"
    if errors:
        text += f", {1e3 * float(np.median(errors)):.1f} mm rms off"
    if share >= USABLE:
        return frames, Row("mocap markers", expected, text, Verdict.OK)
    advice = "place markers as markers.LAYOUT has them, no two distances alike; cover other shiny "
    advice += "things; send metres"
    return frames, Row("mocap markers", expected, text, Verdict.FAIL, advice)


def usable(
    frames: Sequence[FrameSample], settings: TrackerSettings, refused: Mapping[str, int]
) -> list[Row]:
    """What the tracker takes, and whether the pose is alive.

    Args:
        frames: In order of arrival.
        settings: Of the tracker.
        refused: Messages that could not be read at all, by the reason.
    """
    expected = f"at least {USABLE:.0%} of frames usable by the tracker"
    tracker = Tracker(settings)
    for frame in frames:
        tracker.add(*frame[1:])
    counts = Counter(tracker.counts)
    good = counts.pop("accepted", 0)
    counts.pop("found again", 0)
    repeated = counts["pose repeated"]
    frozen = _frozen(frames)
    counts.update(refused)
    total = len(frames) + sum(refused.values())
    rows = [frozen]
    if not total:
        return [frozen, Row("mocap poses", expected, "no frame", Verdict.UNCHECKED)]
    if frozen.verdict is Verdict.FAIL:
        del counts["pose repeated"]
        good += repeated  # said by the other row
    share = good / total
    text = ", ".join([f"{share:.0%} usable", *(f"{n} {what}" for what, n in counts.items() if n)])
    if share >= USABLE:
        return [*rows, Row("mocap poses", expected, text, Verdict.OK)]
    worst = counts.most_common(1)[0][0]
    advice = {
        "zero pose": "the driver sends zeros when it has lost the body: is it in view?",
        "out of workspace": "units not metres, or world_to_base or up_axis wrong",
        "quaternion not of unit length": "the driver must send unit quaternions, x y z w",
        "older of a pair": "frames come two at a time, and the later one is used: a driver that "
        "stamps them itself, such as vrpn_mocap with use_vrpn_timestamps:=true, loses none",
        "jump": "two bodies on one topic, or markers that swap",
    }.get(worst, "see the tracker's diagnostics")
    return [*rows, Row("mocap poses", expected, text, Verdict.FAIL, advice)]


def _frozen(frames: Sequence[FrameSample]) -> Row:
    expected = "poses with the noise of a measurement"
    longest, since, count, last = 0.0, 0, 0, b""
    most = 0
    for frame in frames:
        raw = frame.position.tobytes() + frame.quat_xyzw.tobytes()
        if raw != last:
            last, since, count = raw, frame.stamp_ns, 0
        count += 1
        if count > most:
            most, longest = count, (frame.stamp_ns - since) * 1e-9
    if not frames:
        return Row("mocap frozen", expected, "no frame", Verdict.UNCHECKED)
    text = f"the same pose, bit for bit, {most} times in a row ({longest:.2f} s)"
    if most >= FROZEN_COUNT and longest >= FROZEN_TIME * 1e-9:
        advice = "frozen: the driver repeats its last pose. Is the body in view, Motive streaming?"
        return Row("mocap frozen", expected, text, Verdict.FAIL, advice)
    found = "no pose twice" if most == 1 else text
    return Row("mocap frozen", expected, found, Verdict.OK)


def latency(
    received_ns: np.ndarray,
    stamp_ns: np.ndarray,
    arm_age: float,
    latency_offset: float,
    most: float,
) -> Row:
    """How late frames are, by the clock that the arm's stamps are of.

    Args:
        received_ns: Shape (m,).
        stamp_ns: Shape (m,).
        arm_age: How long after their stamps the arm's states are received [s].
        latency_offset: Configured: how much later than the exposure the stamps are [s].
        most: From which on no rollout is scored [s].
    """
    expected = f"exposed 0 to {1e3 * most:.0f} ms before, by the arm's clock"
    if len(stamp_ns) == 0:
        return Row("mocap latency", expected, "no frame", Verdict.UNCHECKED)
    stamped = float(np.median(received_ns - stamp_ns)) * 1e-9 - arm_age
    age = stamped + latency_offset
    text = f"{1e3 * age:.1f} ms"
    if latency_offset:
        text += f" ({1e3 * latency_offset:.1f} of them by latency_offset)"
    if not -RECEIPT < age < most:
        advice = "synchronise the clocks of arm and motion capture (chrony)"
        return Row("mocap latency", expected, text, Verdict.FAIL, advice)
    if age < RECEIPT:
        text += ": stamped on receipt"
        advice = "put what the cameras, the solver and the network take into latency_offset"
        return Row("mocap latency", expected, text, Verdict.WARN, advice)
    return Row("mocap latency", expected, text, Verdict.OK)


def place(frames: Sequence[FrameSample], settings: TrackerSettings, pan: np.ndarray | None) -> Row:
    """Where the body is in the arm's base frame, and how far from the pan.

    Args:
        frames: In order of arrival.
        settings: Of the tracker.
        pan: Centre of the pan's floor in the base frame [m], None when not known. Shape (3,).
    """
    expected = "lying in the pan, the body is seen there"
    if not frames:
        return Row("mocap frame", expected, "no frame", Verdict.UNCHECKED)
    rotation, origin = _to_base(settings)
    position = rotation @ np.median([frame.position for frame in frames], axis=0) + origin
    text = f"body at {_metres(position)}"
    if pan is None or not np.isfinite(position).all():
        return Row("mocap frame", expected, text, Verdict.UNCHECKED, "no state of the arm")
    text += f", pan at {_metres(pan)} in the base frame"
    if np.linalg.norm(position - pan) <= IN_THE_PAN:
        return Row("mocap frame", expected, text, Verdict.OK)
    advice = "if it lies in the pan, world_to_base or up_axis is wrong"
    return Row("mocap frame", expected, text, Verdict.WARN, advice)


def fall(frames: Sequence[FrameSample], settings: TrackerSettings) -> Row:
    """Which way the body fell that was dropped, and so which axis is up."""
    expected = f"a fall along -z of the base frame, with up_axis: {settings.up_axis}"

    def row(found: str, result: Verdict, advice: str = "") -> Row:
        return Row("mocap axes", expected, found, result, advice)

    t, position = _course(frames)
    raw = _falling(t, position)
    if raw is None:
        if _falling(t, 1e-3 * position) is not None:
            return row("a fall in millimetres", Verdict.FAIL, "send metres")
        advice = "drop the body from a metre or more, edge first, in view"
        return row("no free fall was seen", Verdict.UNCHECKED, advice)
    up = -raw / np.linalg.norm(raw)  # in the motion capture's own axes
    axis = int(np.argmax(np.abs(up)))
    name = f"{'-' if up[axis] < 0.0 else '+'}{'xyz'[axis]}"
    rotation, _ = _to_base(settings)
    cosine = float((rotation @ up)[2])
    found = f"{np.linalg.norm(raw):.2f} m/s^2 along {_metres(rotation @ raw)}, {name} is up"
    off = math.degrees(math.acos(min(1.0, max(-1.0, cosine))))
    if cosine > AWRY[0]:
        return row(found, Verdict.OK)
    if cosine > AWRY[1]:
        advice = f"{off:.0f} degrees off: level the ground plane, or correct world_to_base"
        return row(found, Verdict.WARN, advice)
    if name in ("+y", "+z") and name[1] != settings.up_axis:
        advice = f"{name[1].upper()}-up: set up_axis: {name[1]}"
    else:
        advice = f"world_to_base turns it by {off:.0f} degrees: {name} of the motion capture is up"
    return row(found, Verdict.FAIL, advice)


def _course(frames: Sequence[FrameSample]) -> tuple[np.ndarray, np.ndarray]:
    """Times since the first frame (k,) [s] and positions (k, 3), one of each pair of frames."""
    kept: list[FrameSample] = []
    for frame in frames:
        if np.isfinite(frame.position).all() and (
            not kept or frame.stamp_ns - kept[-1].stamp_ns > PAIR
        ):
            kept.append(frame)
    t = np.array([(frame.stamp_ns - kept[0].stamp_ns) * 1e-9 for frame in kept])
    return t, np.array([frame.position for frame in kept]).reshape(-1, 3)


def _falling(t: np.ndarray, position: np.ndarray) -> np.ndarray | None:
    """Acceleration of a free fall in a course, None when there is none [m/s^2]; shape (3,)."""
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    return falling(BodyPath("dropped", t, position, turns))


def _to_base(settings: TrackerSettings) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and origin (3,) of the motion capture's own frame in the base frame."""
    pose = np.array(settings.world_to_base, dtype=float)
    turn = Y_UP if settings.up_axis == "y" else np.eye(3)
    return rotations.matrix(pose[3:]) @ turn, pose[:3]


def _metres(values: np.ndarray) -> str:
    return "(" + " ".join(f"{value:.2f}" for value in values) + ")"
