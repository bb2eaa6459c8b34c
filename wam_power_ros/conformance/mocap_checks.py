# SPDX-License-Identifier: Apache-2.0
"""Checks of motion capture: frames that the tracker accepts, latency, vertical axis.

The frames are processed by the tracker itself. A dropped body falls along gravity, so its free fall
reveals a wrong axis or base frame.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from wam_power_ros.conformance.topic_checks import FAIL, OK, PAIR_NS, UNCHECKED, WARN, Row
from wam_power_ros.learning.rollout import BodyPath
from wam_power_ros.tracking import marker_fit
from wam_power_ros.tracking.tracker import (
    FROZEN_COUNT,
    FROZEN_TIME,
    IDENTITY,
    FrameFault,
    Tracker,
    TrackerSettings,
    free_fall_acceleration,
    world_in_base,
)

USABLE_SHARE = 0.9  # share of frames that the tracker must accept
LATENCY_MIN = 0.003  # [s] shortest time from exposure to reception
FALL_COSINE_OK, FALL_COSINE_WARN = 0.985, 0.87  # of the angle between a fall and the vertical
TOOL_DISTANCE = 0.1  # [m] from the tool within which a body counts as in it
ADVICE = {  # by the tracker's most frequent reason for refusal
    "zero pose": "the driver sends zeros when it has lost the body: is it in view?",
    "out of workspace": "units are not metres, or world_to_base or up_axis is wrong",
    "quaternion not of unit length": "the driver must send unit quaternions, x y z w",
    "older of a pair": "frames come two at a time, and the later one is used: a driver that "
    "stamps them itself, such as vrpn_mocap with use_vrpn_timestamps:=true, loses none",
    "jump": "two bodies on one topic, or markers that swap",
}


class FrameSample(NamedTuple):
    """One pose as received, in the frame of the motion capture."""

    received_ns: int
    stamp_ns: int
    position: np.ndarray  # (3,)
    quat_xyzw: np.ndarray  # (4,)


class CloudSample(NamedTuple):
    """One cloud of markers as received."""

    received_ns: int
    stamp_ns: int
    points: np.ndarray  # (m, 3)


def marker_poses(
    clouds: Sequence[CloudSample], settings: TrackerSettings
) -> tuple[list[FrameSample], Row]:
    """Find the body's marker or layout in clouds; returns its poses, and the row about them."""
    layout = f"the {len(marker_fit.LAYOUT)} markers of the layout"
    expected = f"{'the marker' if settings.single_marker else layout} in every cloud"
    row, frames, errors = partial(Row, "mocap markers", expected), [], []
    tracker = Tracker(settings)
    for cloud in clouds:
        try:
            if settings.single_marker:
                position = tracker.marker(cloud.stamp_ns, cloud.points)
                tracker.add(cloud.stamp_ns, position, IDENTITY)
                frames.append(FrameSample(*cloud[:2], position, IDENTITY))
                continue
            found = marker_fit.fit(cloud.points)
        except ValueError:
            continue
        errors.append(found.rms)
        frames.append(FrameSample(*cloud[:2], found.position, found.quat_xyzw))
    if not clouds:
        return [], row("no cloud", UNCHECKED)
    counts, share = [len(cloud.points) for cloud in clouds], len(frames) / len(clouds)
    what = "marker" if settings.single_marker else "layout"
    text = f"{min(counts)} to {max(counts)} points, {what} found in {share:.0%}"
    if errors:
        text += f", {1e3 * float(np.median(errors)):.1f} mm rms off"
    if share >= USABLE_SHARE:
        return frames, row(text, OK)
    advice = "place the markers as in marker_fit.LAYOUT, with no two distances alike; "
    advice = "" if settings.single_marker else advice
    return frames, row(text, FAIL, f"{advice}cover other reflective objects; send metres")


def frame_quality(
    frames: Sequence[FrameSample], settings: TrackerSettings, refused: Mapping[str, int]
) -> list[Row]:
    """Rows about frozen poses, and the share of frames that the tracker takes or has `refused`."""
    expected = f"at least {USABLE_SHARE:.0%} of frames usable by the tracker"
    row, frozen = partial(Row, "mocap poses", expected), _frozen(frames)
    tracker = Tracker(settings)
    for frame in frames:
        tracker.add(*frame[1:])
    counts = Counter(tracker.counts)
    good = counts.pop("accepted", 0)
    counts.pop("found again", 0)
    if frozen.verdict is FAIL:
        good += counts.pop(FrameFault.POSE_REPEATED.value, 0)  # reported by the other row
    counts.update(refused)
    total = len(frames) + sum(refused.values())
    if not total:
        return [frozen, row("no frame", UNCHECKED)]
    share = good / total
    faults = (f"{n} {fault}" for fault, n in counts.items() if n)
    text = ", ".join([f"{share:.0%} usable", *faults])
    if share >= USABLE_SHARE:
        return [frozen, row(text, OK)]
    worst = counts.most_common(1)[0][0]
    return [frozen, row(text, FAIL, ADVICE.get(worst, "see the tracker's diagnostics"))]


def _frozen(frames: Sequence[FrameSample]) -> Row:
    """Row about the longest series of identical poses."""
    row = partial(Row, "mocap frozen", "poses with measurement noise")
    longest, since_ns, count, largest, last = 0.0, 0, 0, 0, b""
    for frame in frames:
        raw = frame.position.tobytes() + frame.quat_xyzw.tobytes()
        if raw != last:
            last, since_ns, count = raw, frame.stamp_ns, 0
        count += 1
        if count > largest:
            largest, longest = count, (frame.stamp_ns - since_ns) * 1e-9
    if not frames:
        return row("no frame", UNCHECKED)
    text = f"the same pose, bit for bit, {largest} times in a row ({longest:.2f} s)"
    if largest >= FROZEN_COUNT and longest >= FROZEN_TIME * 1e-9:
        advice = "frozen: the driver repeats its last pose; is the body in view, Motive streaming?"
        return row(text, FAIL, advice)
    return row("no pose twice" if largest == 1 else text, OK)


def latency(
    received_ns: np.ndarray, stamp_ns: np.ndarray, arm_age: float, offset: float, longest: float
) -> Row:
    """Latency of the frames relative to the clock of the arm's stamps.

    Args:
        arm_age: Time from the stamp of a joint state to its arrival [s].
        offset: Configured delay of a stamp after the exposure, latency_offset [s].
        longest: Latency from which on rollouts are not scored [s].
    """
    expected = f"0 to {1e3 * longest:.0f} ms from exposure to reception, by the arm's clock"
    row = partial(Row, "mocap latency", expected)
    if len(stamp_ns) == 0:
        return row("no frame", UNCHECKED)
    age = float(np.median(received_ns - stamp_ns)) * 1e-9 - arm_age + offset
    text = f"{1e3 * age:.1f} ms"
    text += f" ({1e3 * offset:.1f} of them by latency_offset)" if offset else ""
    if not -LATENCY_MIN < age < longest:
        return row(text, FAIL, "synchronise the clocks of arm and motion capture (chrony)")
    if age < LATENCY_MIN:
        advice = "add the delays of cameras, solver and network to latency_offset"
        return row(f"{text}: stamped on receipt", WARN, advice)
    return row(text, OK)


def body_position(
    frames: Sequence[FrameSample], settings: TrackerSettings, tool: np.ndarray | None
) -> Row:
    """Position of the body in the arm's base frame, and its distance [m] from the tool's."""
    row = partial(Row, "mocap frame", "a body in the tool is measured in the tool")
    if not frames:
        return row("no frame", UNCHECKED)
    rotation, origin = world_in_base(settings)
    position = rotation @ np.median([frame.position for frame in frames], axis=0) + origin
    text = f"body at {_listed(position)}"
    if tool is None or not np.isfinite(position).all():
        return row(text, UNCHECKED, "no state of the arm")
    text += f", tool at {_listed(tool)} in the base frame"
    if np.linalg.norm(position - tool) <= TOOL_DISTANCE:
        return row(text, OK)
    return row(text, WARN, "if it lies in the tool, world_to_base or up_axis is wrong")


def fall_direction(frames: Sequence[FrameSample], settings: TrackerSettings) -> Row:
    """Direction in which a dropped body fell, which shows the vertical axis."""
    expected = f"a fall along -z of the base frame, with up_axis: {settings.up_axis}"
    row = partial(Row, "mocap axes", expected)
    t, position = _trajectory(frames)
    raw = _free_fall(t, position)
    if raw is None:
        if _free_fall(t, 1e-3 * position) is not None:
            return row("a fall in millimetres", FAIL, "send metres")
        advice = "drop the body from a metre or more, edge first, in view"
        return row("no free fall was measured", UNCHECKED, advice)
    up = -raw / np.linalg.norm(raw)  # in the motion capture's axes
    axis = int(np.argmax(np.abs(up)))
    name = f"{'-' if up[axis] < 0.0 else '+'}{'xyz'[axis]}"
    rotation, _ = world_in_base(settings)
    cosine = float((rotation @ up)[2])
    found = f"{np.linalg.norm(raw):.2f} m/s^2 along {_listed(rotation @ raw)}, {name} is up"
    angle = math.degrees(math.acos(min(1.0, max(-1.0, cosine))))
    if cosine > FALL_COSINE_OK:
        return row(found, OK)
    if cosine > FALL_COSINE_WARN:
        advice = f"{angle:.0f} degrees off: level the ground plane, or correct world_to_base"
        return row(found, WARN, advice)
    if name in ("+y", "+z") and name[1] != settings.up_axis:
        return row(found, FAIL, f"{name[1].upper()}-up: set up_axis: {name[1]}")
    advice = f"world_to_base is off by {angle:.0f} degrees: {name} of the motion capture is up"
    return row(found, FAIL, advice)


def _trajectory(frames: Sequence[FrameSample]) -> tuple[np.ndarray, np.ndarray]:
    """Times since the first frame (k,) [s] and positions (k, 3) [m]; pairs of frames count once."""
    kept: list[FrameSample] = []
    for frame in frames:
        separate = not kept or frame.stamp_ns - kept[-1].stamp_ns > PAIR_NS
        if separate and np.isfinite(frame.position).all():
            kept.append(frame)
    t = np.array([(frame.stamp_ns - kept[0].stamp_ns) * 1e-9 for frame in kept])
    return t, np.array([frame.position for frame in kept]).reshape(-1, 3)


def _free_fall(t: np.ndarray, position: np.ndarray) -> np.ndarray | None:
    """Acceleration (3,) [m/s^2] during a free fall in a trajectory, None without one."""
    level = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    return free_fall_acceleration(BodyPath("dropped", t, position, level))


def _listed(values: np.ndarray) -> str:
    return "(" + " ".join(f"{value:.2f}" for value in values) + ")"
