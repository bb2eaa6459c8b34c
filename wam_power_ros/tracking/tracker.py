# SPDX-License-Identifier: Apache-2.0
"""Tracking of a body in motion capture: every frame is checked, faulty ones are refused.

Motion capture loses sight of a body, repeats its last pose with a new stamp, sends zeros, swaps
bodies and stamps late. Such frames are counted by fault and enter neither the state nor the path.
Stamps are `int` nanoseconds and never summed, so results do not depend on absolute time.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from enum import Enum
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator
from typing_extensions import Self

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import LEAD_TIME, BodyPath
from wam_power_ros.tracking import marker_fit

SECOND = 1_000_000_000  # [ns]
GRAVITY = 9.81  # [m/s^2]
HISTORY_TIME = 20 * SECOND  # age of the oldest frame that is kept for paths [ns]
INTERVAL_MIN = SECOND // 1000  # frames with closer stamps were stamped on delivery [ns]
FROZEN_COUNT = 10  # consecutive bit-identical poses, over FROZEN_TIME, that count as frozen
FROZEN_TIME = 3 * SECOND // 10  # shortest duration of a frozen pose [ns]
JUMP_COUNT = 5  # consecutive jumps after which the body is lost
REACQUIRE_COUNT = 5  # consecutive consistent frames after which a lost body is found again
SET_BACK_COUNT = 10  # consecutive older stamps that mean that the clock was set back
COAST_TIME = SECOND // 10  # extrapolation of a hidden body at constant velocity [ns]
VELOCITY_WINDOW = SECOND // 10  # window of the velocity estimate, at least two periods [ns]
OFFSET_WINDOW = 5 * SECOND  # over which the offset of the clocks is estimated [ns]
FALL_SPAN = 0.2  # time over which a parabola is fitted to a fall [s]
TURN_MAX = 30.0  # largest change of the angular velocity within a frame: a toss has 20 [rad/s]
TURN_SLACK = 0.2  # error of an orientation and of its prediction [rad]
TURN_SEEN = 2.2  # larger errors of a prediction are another solution of the pose [rad]
TURN_PREDICTED = SECOND // 10  # for which an orientation is predicted while others are refused [ns]
TURN_TIME = 3 * SECOND  # after which other orientations are taken, past the end of a rollout [ns]
UNIT_TOLERANCE = 1e-3  # largest deviation of a quaternion's length from 1 [1]
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])  # quaternion xyzw
IDENTITY.flags.writeable = False
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # (x, y, z) -> (x, -z, y)


class FrameFault(Enum):
    """Reason for refusing a frame; the value is the text for messages."""

    MESSAGE = "message not valid"
    NOT_FINITE = "not finite"
    ZERO = "zero pose"
    NOT_UNIT = "quaternion not of unit length"
    STAMP_BACK = "stamp goes back"
    STAMP_REPEATED = "stamp repeated"
    POSE_REPEATED = "pose repeated"
    OUTSIDE = "out of workspace"
    JUMP = "jump"
    TURN = "turned too fast"
    MARKERS = "markers not clear"


class Validity(Enum):
    """Validity of the state, judged by the newest frames."""

    OK = "ok"
    OCCLUDED = "occluded"  # no frame for more than two periods: extrapolated
    FROZEN = "frozen"  # the same pose, bit for bit, for too long
    JUMP = "jump"  # farther from the last pose than the body can move
    LOST = "lost"  # no valid frame yet, or none for too long


class TrackedState(NamedTuple):
    """State of the body at one time, in the base frame.

    Attributes:
        stamp_ns: Time of exposure [ns].
        position: Position, measured or extrapolated [m]. Shape (3,).
        quat_xyzw: Orientation, measured or extrapolated. Shape (4,).
        velocity: Least-squares slope of the positions of the last 0.1 s, without a model of
            gravity: in free flight it lags by 0.05 s [m/s]. Shape (3,).
        angular_velocity: Least-squares slope of the rotations, likewise [rad/s]. Shape (3,).
        variance: Variance of the position along an axis; grows while occluded [m^2].
        validity: OK, or OCCLUDED when extrapolated.
    """

    stamp_ns: int
    position: np.ndarray
    quat_xyzw: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    variance: float
    validity: Validity


Coordinate = Annotated[float, Field(ge=-50.0, le=50.0)]
Corner = tuple[Coordinate, Coordinate, Coordinate]
Unit = Annotated[float, Field(ge=-1.0, le=1.0)]
WorldToBase = tuple[Coordinate, Coordinate, Coordinate, Unit, Unit, Unit, Unit]


class TrackerSettings(BaseModel):
    """Settings of the tracker: properties of the motion capture and of the body.

    Attributes:
        rate: Frame rate [Hz].
        up_axis: Vertical axis of the motion capture.
        world_to_base: Pose of the origin of the motion capture, z up, in the base frame of the
            arm: x, y, z [m] and quaternion xyzw.
        latency_offset: Delay from exposure to stamp [s].
        workspace_low: Smallest plausible position in the base frame [m].
        workspace_high: Largest plausible position in the base frame [m].
        speed_max: Largest plausible speed of the body [m/s].
        noise: Standard deviation of a position along an axis [m].
        single_marker: True for a body with one marker, which has a position alone: its orientation
            is always the identity.

    Raises:
        ValueError: If a value is out of range; the message names it.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    rate: float = Field(ge=10.0, le=1000.0, description="in Hz: below, a flight of 0.4 s is missed")
    up_axis: Literal["z", "y"]
    world_to_base: WorldToBase = Field(description="in m: a room of 50 m; unit quaternion")
    latency_offset: float = Field(
        ge=-1.0, le=1.0, description="in s: more than 1 s is a clock offset, not a delay"
    )
    workspace_low: Corner = Field(description="in m: a room of 50 m")
    workspace_high: Corner = Field(description="in m: a room of 50 m")
    speed_max: float = Field(
        ge=1.0, le=50.0, description="in m/s: a toss has 4; 50 is 0.5 m between frames at 100 Hz"
    )
    noise: float = Field(
        ge=1e-6,
        le=0.05,
        description="in m: above any camera's resolution; 0.05 is half a pancake's radius",
    )
    single_marker: bool

    @model_validator(mode="after")
    def _together(self) -> Self:
        if abs(math.hypot(*self.world_to_base[3:]) - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"quaternion of world_to_base {self.world_to_base} must have length 1")
        low, high = self.workspace_low, self.workspace_high
        if not all(least < most for least, most in zip(low, high, strict=True)):
            raise ValueError(f"workspace_low {low} must be below workspace_high {high}")
        return self


class _Frame(NamedTuple):
    """Pose in the base frame: stamp [ns], position [m] (3,) and orientation (4,)."""

    stamp_ns: int
    position: np.ndarray
    quat_xyzw: np.ndarray


def world_in_base(settings: TrackerSettings) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and origin (3,) [m] of the motion capture's frame in the base frame."""
    pose = np.array(settings.world_to_base, dtype=float)
    turn = Y_UP if settings.up_axis == "y" else np.eye(3)
    return rotations.matrix(pose[3:]) @ turn, pose[:3]


class Tracker:
    """Estimates state and path of one body from raw frames of the motion capture.

    Attributes:
        validity: Validity of the state.
        counts: Number of frames by outcome: "accepted", or the fault of refused ones.
        fault: Fault of the newest frame, None if it was accepted.
        latest_ns: Newest stamp of any frame minus the latency offset; 0 before the first [ns].
    """

    def __init__(self, settings: TrackerSettings) -> None:
        self._settings = settings
        matrix, self._origin = world_in_base(settings)
        self._rotation, self._quat = matrix, rotations.quat_xyzw(matrix)
        self._latency = round(settings.latency_offset * 1e9)
        self._gap_max = round(2e9 / settings.rate)  # longest gap that is not an occlusion [ns]
        self._window = max(VELOCITY_WINDOW, self._gap_max) + INTERVAL_MIN
        self.counts: Counter[str] = Counter()
        self.fault: FrameFault | None = None
        self._restart()

    def _restart(self) -> None:
        self.validity = Validity.LOST
        self.latest_ns = 0
        self._frames: deque[_Frame] = deque()
        self._track_start = 0  # stamp from which on the frames are one continuous movement [ns]
        self._state: TrackedState | None = None
        self._raw, self._raw_since, self._repeats = b"", 0, 0  # last pose, its first stamp, count
        self._older_stamps = self._jumps = self._consistent = 0  # consecutive frames
        self._candidate: _Frame | None = None  # last frame that jumped
        self._turned_ns = 0  # stamp of the first of the last frames that turned too fast; 0: none

    def add(
        self, stamp_ns: int, position: np.ndarray, quat_xyzw: np.ndarray
    ) -> TrackedState | None:
        """Add one frame, in the coordinates and on the clock of the motion capture.

        Args:
            stamp_ns: Stamp of the message [ns].
            position: Position of the body [m]. Shape (3,).
            quat_xyzw: Orientation of the body, unit quaternion; unused for a single marker.
                Shape (4,).

        Returns:
            The state; None if the frame was refused (see `fault`) or is the first one after a gap,
            without a velocity yet.

        Raises:
            ValueError: If an array has a wrong shape.
        """
        position, quat_xyzw = np.asarray(position, dtype=float), np.asarray(quat_xyzw, dtype=float)
        fault = _pose_fault(position, quat_xyzw) or self._stamp_fault(stamp_ns - self._latency)
        if fault:
            self.refuse(fault)
            return None
        frame = self._in_base(stamp_ns - self._latency, position, quat_xyzw)
        self.latest_ns = frame.stamp_ns
        if self._is_repeated(frame.stamp_ns, position.tobytes() + quat_xyzw.tobytes()):
            duration = frame.stamp_ns - self._raw_since
            frozen = self._repeats >= FROZEN_COUNT and duration >= FROZEN_TIME
            self.refuse(FrameFault.POSE_REPEATED, Validity.FROZEN if frozen else None)
            return None
        if not self._is_inside(frame):
            self.refuse(FrameFault.OUTSIDE)
            return None
        # Of frames that were delivered together, only the last one has a correct stamp.
        pair = self._frames and frame.stamp_ns - self._frames[-1].stamp_ns < INTERVAL_MIN
        older = [self._frames.pop()] if pair else []
        if not self._is_reachable(frame):
            self._frames.extend(older)
            self._jumps += 1
            lost = self._jumps >= JUMP_COUNT
            self.refuse(FrameFault.JUMP, Validity.LOST if lost else Validity.JUMP)
            return None
        if self._turns_too_fast(frame):
            self._frames.extend(older)
            self.refuse(FrameFault.TURN)
            return None
        if older:
            self.counts["accepted"] -= 1
            self.counts["older of a pair"] += 1
        return self._accept(frame)

    def add_markers(self, stamp_ns: int, points: np.ndarray) -> TrackedState | None:
        """Add the body's marker or layout in one unlabelled cloud (m, 3) [m]; see `add`."""
        try:
            if self._settings.single_marker:
                return self.add(stamp_ns, self.marker(stamp_ns, points), IDENTITY)
            pose = marker_fit.fit(points)
        except ValueError:
            self.latest_ns = max(self.latest_ns, stamp_ns - self._latency)
            self.refuse(FrameFault.MARKERS)
            return None
        return self.add(stamp_ns, pose.position, pose.quat_xyzw)

    def marker(self, stamp_ns: int, points: np.ndarray) -> np.ndarray:
        """Find the marker (3,) [m] of a body with one among the points (m, 3) [m] of a cloud.

        It is the only point in the workspace, or the nearest to the last position if the next one
        is more than twice as far.

        Raises:
            ValueError: Neither is the case, or there are too many points.
        """
        if len(points) > marker_fit.COUNT_MAX:
            raise ValueError(f"{len(points)} points; at most {marker_fit.COUNT_MAX} are searched")
        frames = [self._in_base(stamp_ns - self._latency, point, IDENTITY) for point in points]
        inside = [number for number, frame in enumerate(frames) if self._is_inside(frame)]
        if len(inside) > 1 and self._frames:
            last = self._frames[-1].position
            distance = {number: math.dist(frames[number].position, last) for number in inside}
            first, second, *_ = sorted(inside, key=distance.__getitem__)
            inside = [first] if 2.0 * distance[first] < distance[second] else inside
        if len(inside) != 1:
            raise ValueError(f"{len(inside)} points in the workspace may be the marker")
        return points[inside[0]]

    def refuse(self, fault: FrameFault, validity: Validity | None = None) -> None:
        """Count a refused frame by its fault; set `validity` unless omitted."""
        self.counts[fault.value] += 1
        self.fault = fault
        if validity is not None:
            self.validity = validity

    def at(self, stamp_ns: int) -> TrackedState | None:
        """State at a time [ns] not before the newest frame; updates `validity`.

        Returns:
            The last state, extrapolated at constant velocity after two periods without a frame;
            None while the body is frozen, jumping or lost.
        """
        state = self._state
        if state is None or self.validity not in (Validity.OK, Validity.OCCLUDED):
            return None
        age = stamp_ns - state.stamp_ns
        if age <= self._gap_max:
            return state
        if age > self._gap_max + COAST_TIME:
            self.validity = Validity.LOST
            return None
        self.validity = Validity.OCCLUDED
        dt = age * 1e-9
        turn = rotations.quat_of_vector(state.angular_velocity * dt)
        return state._replace(
            stamp_ns=stamp_ns,
            position=state.position + state.velocity * dt,
            quat_xyzw=rotations.multiply(turn, state.quat_xyzw),
            variance=(self._settings.noise + 0.5 * GRAVITY * dt**2) ** 2,
            validity=Validity.OCCLUDED,
        )

    def path(self, rollout_id: str, t0_ns: int, t1_ns: int) -> BodyPath:
        """Path of the accepted frames of a rollout, in time since its start `t0_ns`.

        Those from LEAD_TIME before the start to its end `t1_ns`, inclusive; it shows the body at
        rest, whatever the rollout does to it.
        """
        begin_ns = t0_ns - LEAD_TIME
        frames = [frame for frame in self._frames if begin_ns <= frame.stamp_ns <= t1_ns]
        return BodyPath(
            id=rollout_id,
            t=np.array([(frame.stamp_ns - t0_ns) * 1e-9 for frame in frames]),
            position=np.array([frame.position for frame in frames]).reshape(-1, 3),
            quat_xyzw=np.array([frame.quat_xyzw for frame in frames]).reshape(-1, 4),
        )

    def _in_base(self, stamp_ns: int, position: np.ndarray, quat_xyzw: np.ndarray) -> _Frame:
        quat = rotations.normalised(rotations.multiply(self._quat, quat_xyzw))
        quat = IDENTITY if self._settings.single_marker else quat
        return _Frame(stamp_ns, self._rotation @ position + self._origin, quat)

    def _is_inside(self, frame: _Frame) -> bool:
        low, high = self._settings.workspace_low, self._settings.workspace_high
        bounds = zip(low, frame.position.tolist(), high, strict=True)
        return all(least <= x <= most for least, x, most in bounds)

    def _stamp_fault(self, stamp_ns: int) -> FrameFault | None:
        """Fault of a stamp, if any; restarts the track if the clock was set back."""
        if stamp_ns < self.latest_ns:
            self._older_stamps += 1
            if self._older_stamps < SET_BACK_COUNT:
                return FrameFault.STAMP_BACK
            self.counts["clock set back"] += 1
            self._restart()
            return None
        self._older_stamps = 0
        return FrameFault.STAMP_REPEATED if stamp_ns == self.latest_ns else None

    def _is_repeated(self, stamp_ns: int, raw: bytes) -> bool:
        """Whether a pose equals the last one bit for bit, which noise makes impossible."""
        if raw == self._raw:
            self._repeats += 1
            return True
        self._raw, self._raw_since, self._repeats = raw, stamp_ns, 1
        return False

    def _is_reachable(self, frame: _Frame) -> bool:
        """Whether the body can have moved here, or was seen near here for several frames."""
        if not self._frames:
            return True
        time_max = (
            self._gap_max if self._jumps else HISTORY_TIME
        )  # after a jump the gate stops growing
        if self._gate(self._frames[-1], frame, time_max):
            return True
        consistent = self._candidate is not None and self._gate(
            self._candidate, frame, HISTORY_TIME
        )
        self._consistent = self._consistent + 1 if consistent else 1
        self._candidate = frame
        if self._consistent < REACQUIRE_COUNT:
            return False
        self.counts["found again"] += 1
        self._track_start = frame.stamp_ns
        return True

    def _gate(self, last: _Frame, frame: _Frame, time_max: int) -> bool:
        """Whether the body can have moved from one frame to another within at most `time_max`."""
        dt = min(frame.stamp_ns - last.stamp_ns, time_max) * 1e-9
        step = math.dist(frame.position, last.position)
        return step <= self._settings.speed_max * dt + 5.0 * self._settings.noise

    def _turns_too_fast(self, frame: _Frame) -> bool:
        """Whether an orientation is none that the body can have reached since the last one.

        Other solutions of a pose are, a half turn away or less. Where they stay, the orientation is
        not known any more: refused for longer than a rollout takes.
        """
        last = self._frames[-1] if self._frames else None
        since = 0 if last is None else frame.stamp_ns - last.stamp_ns
        if (
            last is None
            or last.stamp_ns < self._track_start
            or (since > self._gap_max and not self._turned_ns)
        ):
            return False
        spin = np.zeros(3) if self._state is None else self._state.angular_velocity
        inverse = last.quat_xyzw * np.array([-1.0, -1.0, -1.0, 1.0])
        turn = rotations.multiply(frame.quat_xyzw, inverse)
        predicted = rotations.quat_of_vector(-spin * since * 1e-9)
        error = np.linalg.norm(rotations.rotation_vector(rotations.multiply(predicted, turn)))
        longest = self._gap_max // 2 if self._turned_ns else self._gap_max
        most = TURN_SLACK + TURN_MAX * min(since, longest) * 1e-9
        known = not self._turned_ns or since <= TURN_PREDICTED
        if error <= min(most, TURN_SEEN) and known:
            self._turned_ns = 0
            return False
        self._turned_ns = self._turned_ns or frame.stamp_ns
        if frame.stamp_ns - self._turned_ns < TURN_TIME:
            return True
        self._turned_ns, self._track_start = 0, frame.stamp_ns
        return False

    def _accept(self, frame: _Frame) -> TrackedState | None:
        self._jumps = self._consistent = 0
        self._frames.append(frame)
        while frame.stamp_ns - self._frames[0].stamp_ns > HISTORY_TIME:
            self._frames.popleft()
        self.validity, self.fault = Validity.OK, None
        self.counts["accepted"] += 1
        self._state = self._estimate(frame)
        return self._state

    def _estimate(self, last: _Frame) -> TrackedState | None:
        """State at the last frame, None if it is the only one in the velocity window."""
        recent: list[_Frame] = []
        for frame in reversed(self._frames):
            if frame.stamp_ns < max(last.stamp_ns - self._window, self._track_start):
                break
            recent.append(frame)
        if len(recent) < 2:
            return None
        t = np.array([(frame.stamp_ns - last.stamp_ns) * 1e-9 for frame in recent])  # (n,)
        t -= t.mean()
        slope = t / t.dot(t)  # (n,) slope of a least-squares line
        inverse = last.quat_xyzw * np.array([-1.0, -1.0, -1.0, 1.0])
        turns = np.array(  # (n, 3)
            [
                rotations.rotation_vector(rotations.multiply(frame.quat_xyzw, inverse))
                for frame in recent
            ]
        )
        return TrackedState(
            last.stamp_ns,
            last.position,
            last.quat_xyzw,
            velocity=slope @ np.array([frame.position for frame in recent]),
            angular_velocity=slope @ rotations.continuous(turns),
            variance=self._settings.noise**2,
            validity=Validity.OK,
        )


def _pose_fault(position: np.ndarray, quat_xyzw: np.ndarray) -> FrameFault | None:
    """Fault of a pose, if any."""
    if position.shape != (3,) or quat_xyzw.shape != (4,):
        raise ValueError(f"pose of shapes {position.shape}, {quat_xyzw.shape}, not (3,), (4,)")
    place, turn = position.tolist(), quat_xyzw.tolist()
    if not all(map(math.isfinite, place + turn)):
        return FrameFault.NOT_FINITE
    if not any(place):
        return FrameFault.ZERO
    if abs(math.hypot(*turn) - 1.0) > UNIT_TOLERANCE:
        return FrameFault.NOT_UNIT
    return None


DAY = 86_400.0  # [s] clocks that differ by more are not the same clock


class ClockOffset:
    """Age of frames on receipt: latency plus the offset of the motion capture's clock from ours.

    The window of 5 s does not depend on the frame rate: a tracker that was not scheduled receives
    seconds of late frames at once, which must not count as an offset of the clocks.
    """

    def __init__(self) -> None:
        self._frames: deque[tuple[int, int]] = deque()  # time of receipt, age [ns]

    def add(self, stamp_ns: int, received_ns: int) -> None:
        """Add a frame with its stamp and its time of receipt on the clock of this machine [ns]."""
        frames = self._frames
        frames.append((received_ns, received_ns - stamp_ns))
        while not 0 <= received_ns - frames[0][0] <= OFFSET_WINDOW:
            frames.popleft()

    @property
    def seconds(self) -> float:
        """Smallest age on receipt in absolute value, which is insensitive to jitter [s]."""
        return min((age for _, age in self._frames), key=abs, default=0) * 1e-9


def late_stamps(offset: float) -> str:
    """Say why stamps differ from the time of receipt by `offset` [s], and what to do."""
    cause = "synchronise the clocks or set latency_offset"
    if abs(offset) > DAY:
        cause = "those of another clock; a stand-in in lockstep needs use_sim_time: true here"
    return f"stamps {offset:.3f} s off: {cause}"


def free_fall_acceleration(path: BodyPath) -> np.ndarray | None:
    """Acceleration of a body in the parts of its path that are clearly in free fall.

    It must point along -z; otherwise `up_axis` or `world_to_base` is wrong.

    Args:
        path: Path of a rollout.

    Returns:
        Mean over all fitted parabolas with an acceleration within 1 m/s^2 of gravity and an rms
        residual below 2 mm [m/s^2], shape (3,); None if there are fewer than two.
    """
    found = []
    for start in path.t:
        inside = (path.t >= start) & (path.t <= start + FALL_SPAN + 1e-6)
        t = path.t[inside] - start
        if len(t) < 5 or t[-1] < 0.8 * FALL_SPAN or np.diff(t).max() > 0.5 * FALL_SPAN:
            continue
        terms = np.stack([np.ones_like(t), t, 0.5 * t**2], axis=1)  # (m, 3)
        solution, *_ = np.linalg.lstsq(terms, path.position[inside], rcond=None)
        error = path.position[inside] - terms @ solution
        rms = np.sqrt(np.mean(np.sum(error**2, axis=1)))
        if rms < 2e-3 and abs(np.linalg.norm(solution[2]) - GRAVITY) < 1.0:
            found.append(solution[2])
    return np.mean(found, axis=0) if len(found) >= 2 else None
