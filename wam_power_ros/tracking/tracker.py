# SPDX-License-Identifier: Apache-2.0
"""The pancake as motion capture sees it: every frame checked, the bad ones refused by name.

A real system loses sight, repeats its last pose as if it were new, sends zeros, swaps bodies and
stamps late. A frame that is any of these is counted under its fault and becomes neither state nor
path. Stamps are `int` nanoseconds and never added up, so results do not depend on absolute time.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath
from wam_power_ros.tracking import marker_fit

SECOND = 1_000_000_000  # [ns]
GRAVITY = 9.81  # [m/s^2]
HISTORY = 20 * SECOND  # kept for paths
INTERVAL_MIN = SECOND // 1000  # stamps nearer are of receipt: frames that were delivered together
FROZEN_FRAMES, FROZEN_TIME = 10, 3 * SECOND // 10  # of bit-identical poses
REJECTS = 5  # jumps in a row that lose the pancake
REACQUIRE = 5  # frames that agree with each other, and are the pancake again
SET_BACK = 10  # frames in a row from the past: the clock was set back
COAST = SECOND // 10  # how long a hidden pancake is taken to fly on
WINDOW = SECOND // 10  # of the velocity, or two periods if that is longer
OFFSET_WINDOW = 5 * SECOND  # of the frames that tell how far clocks are apart
UNIT = 1e-3  # how far from 1 the length of a quaternion may be
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # (x, y, z) -> (x, -z, y)


class Validity(Enum):
    """What the newest frames are worth."""

    OK = "ok"
    OCCLUDED = "occluded"  # no frame for more than two periods: coasting
    FROZEN = "frozen"  # the same pose, bit for bit, again and again
    JUMP = "jump"  # farther from the last pose than the pancake can fly
    LOST = "lost"  # not seen yet, or nothing usable for too long


class TrackedState(NamedTuple):
    """The pancake at one time; everything, the twist too, in the base frame.

    Attributes:
        stamp_ns: Of the exposure [ns].
        position: As measured [m], or coasted. Shape (3,).
        quat_xyzw: As measured, or coasted. Shape (4,).
        velocity: Least squares over the frames of the last 0.1 s, no gravity assumed [m/s]: in free
            flight it lags by 0.05 s. Shape (3,).
        angular_velocity: As the velocity [rad/s]. Shape (3,).
        variance: Of the position along an axis [m^2]; grows while coasting.
        validity: OK, or OCCLUDED while coasting.
    """

    stamp_ns: int
    position: np.ndarray
    quat_xyzw: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    variance: float
    validity: Validity


@dataclass(frozen=True)
class TrackerSettings:
    """What the tracker has to know about the motion capture.

    Attributes:
        rate: Frames a second [Hz].
        up_axis: Which axis of the motion capture points up, "z" or "y".
        world_to_base: Pose of the motion capture's origin, z up, in the arm's base frame:
            x, y, z [m] and quaternion xyzw.
        latency_offset: By how much the stamps are later than the exposure [s].
        workspace_low: Smallest believable position in the base frame [m].
        workspace_high: Largest believable position [m].
        speed_max: Fastest believable pancake [m/s].
        noise: Standard deviation of a position along an axis [m].

    Raises:
        ValueError: Naming the value that is out of its range.
    """

    rate: float
    up_axis: str
    world_to_base: tuple[float, ...]
    latency_offset: float
    workspace_low: tuple[float, ...]
    workspace_high: tuple[float, ...]
    speed_max: float
    noise: float

    def __post_init__(self) -> None:
        for name in ("rate", "speed_max", "noise"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} {getattr(self, name)} must be positive and finite")
        if self.up_axis not in ("y", "z"):
            raise ValueError(f"up_axis {self.up_axis!r} must be 'y' or 'z'")
        pose = np.array(self.world_to_base, dtype=float)
        if pose.shape != (7,) or not np.isfinite(pose).all():
            raise ValueError(f"world_to_base {self.world_to_base} must be 7 numbers: xyz, xyzw")
        if abs(np.linalg.norm(pose[3:]) - 1.0) > UNIT:
            raise ValueError(
                f"quaternion of world_to_base {self.world_to_base} must be of length 1"
            )
        if not abs(self.latency_offset) < 1.0:
            raise ValueError(f"latency_offset {self.latency_offset} s must be within 1 s")
        box = np.array([self.workspace_low, self.workspace_high], dtype=float)
        if box.shape != (2, 3) or not (box[0] < box[1]).all():
            raise ValueError(f"workspace {box.tolist()} must be two corners, low below high")


class _Frame(NamedTuple):
    stamp_ns: int
    position: np.ndarray  # (3,) [m] in the base frame
    quat_xyzw: np.ndarray  # (4,)


class Tracker:
    """Raw frames in, the state of the pancake and its path out.

    Attributes:
        validity: Of the newest frame.
        counts: Frames by what became of them: "accepted", or the fault they were refused for.
        fault: Of the newest frame, "" when it was accepted.
        latest_ns: Newest stamp of any frame, less the latency offset; 0 before the first.
    """

    def __init__(self, settings: TrackerSettings) -> None:
        self._settings = settings
        pose = np.array(settings.world_to_base, dtype=float)
        matrix = rotations.matrix(pose[3:]) @ (Y_UP if settings.up_axis == "y" else np.eye(3))
        self._rotation, self._quat, self._origin = matrix, rotations.quat_xyzw(matrix), pose[:3]
        self._latency = round(settings.latency_offset * 1e9)
        self._patience = round(2e9 / settings.rate)  # [ns] without a frame
        self._window = max(WINDOW, self._patience) + INTERVAL_MIN
        self.counts: Counter[str] = Counter()
        self.fault = ""
        self._restart()

    def _restart(self) -> None:
        self.validity = Validity.LOST
        self.latest_ns = 0
        self._frames: deque[_Frame] = deque()
        self._since = 0  # stamp from which on the frames are one movement
        self._state: TrackedState | None = None
        self._raw, self._raw_since, self._repeats = b"", 0, 0  # last pose, its first stamp
        self._behind = self._rejects = self._agree = 0
        self._candidate: _Frame | None = None

    def add(
        self, stamp_ns: int, position: np.ndarray, quat_xyzw: np.ndarray
    ) -> TrackedState | None:
        """Take one frame of the motion capture, in its own frame and with its own stamp.

        Args:
            stamp_ns: As sent [ns].
            position: [m]. Shape (3,).
            quat_xyzw: Unit. Shape (4,).

        Returns:
            The state, or None: the frame was refused (`fault` says why), or it is the first after a
            gap, with no velocity yet.

        Raises:
            ValueError: An array of another shape.
        """
        position, quat_xyzw = np.asarray(position, dtype=float), np.asarray(quat_xyzw, dtype=float)
        fault = _pose_fault(position, quat_xyzw) or self._stamp_fault(stamp_ns - self._latency)
        if fault:
            return self._refuse(fault)
        frame = self._in_base(stamp_ns - self._latency, position, quat_xyzw)
        self.latest_ns = frame.stamp_ns
        if self._is_repeated(frame.stamp_ns, position.tobytes() + quat_xyzw.tobytes()):
            held = frame.stamp_ns - self._raw_since
            frozen = self._repeats >= FROZEN_FRAMES and held >= FROZEN_TIME
            return self._refuse("pose repeated", Validity.FROZEN if frozen else None)
        low, high = self._settings.workspace_low, self._settings.workspace_high
        place = zip(low, frame.position.tolist(), high, strict=True)
        if not all(least <= x <= most for least, x, most in place):
            return self._refuse("out of workspace")
        # Of frames delivered together only the last one is as old as its stamp says.
        pair = self._frames and frame.stamp_ns - self._frames[-1].stamp_ns < INTERVAL_MIN
        older = [self._frames.pop()] if pair else []
        if not self._is_reachable(frame):
            self._frames.extend(older)
            self._rejects += 1
            lost = self._rejects >= REJECTS
            return self._refuse("jump", Validity.LOST if lost else Validity.JUMP)
        if older:
            self.counts["accepted"] -= 1
            self.counts["older of a pair"] += 1
        return self._accept(frame)

    def add_markers(self, stamp_ns: int, points: np.ndarray) -> TrackedState | None:
        """Take one unlabelled cloud (m, 3) [m]; see `add`. The pose is that of the layout."""
        try:
            pose = marker_fit.fit(points)
        except ValueError:
            self.latest_ns = max(self.latest_ns, stamp_ns - self._latency)
            return self._refuse("markers not clear")
        return self.add(stamp_ns, pose.position, pose.quat_xyzw)

    def refuse(self, fault: str) -> None:
        """Count a frame that was refused before it got here."""
        self._refuse(fault)

    def at(self, stamp_ns: int) -> TrackedState | None:
        """The state at a time [ns] not before the newest frame; keeps `validity` up to date.

        Returns:
            The last state; flown on at constant velocity when no frame has come for two periods;
            None when the pancake is frozen, jumping or lost.
        """
        state = self._state
        if state is None or self.validity not in (Validity.OK, Validity.OCCLUDED):
            return None
        age = stamp_ns - state.stamp_ns
        if age <= self._patience:
            return state
        if age > self._patience + COAST:
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

    def path(self, id: str, t0_ns: int, t1_ns: int) -> BodyPath:
        """The accepted frames from `t0_ns` to `t1_ns`, both included, with times since `t0_ns`."""
        frames = [frame for frame in self._frames if t0_ns <= frame.stamp_ns <= t1_ns]
        return BodyPath(
            id=id,
            t=np.array([(frame.stamp_ns - t0_ns) * 1e-9 for frame in frames]),
            position=np.array([frame.position for frame in frames]).reshape(-1, 3),
            quat_xyzw=np.array([frame.quat_xyzw for frame in frames]).reshape(-1, 4),
        )

    def _in_base(self, stamp_ns: int, position: np.ndarray, quat_xyzw: np.ndarray) -> _Frame:
        quat = rotations.normalised(rotations.multiply(self._quat, quat_xyzw))
        return _Frame(stamp_ns, self._rotation @ position + self._origin, quat)

    def _refuse(self, fault: str, validity: Validity | None = None) -> None:
        self.counts[fault] += 1
        self.fault = fault
        if validity is not None:
            self.validity = validity

    def _stamp_fault(self, stamp_ns: int) -> str:
        """Why a stamp is not the next one, or ""; starts again when the clock was set back."""
        if stamp_ns < self.latest_ns:
            self._behind += 1
            if self._behind < SET_BACK:
                return "stamp goes back"
            self.counts["clock set back"] += 1
            self._restart()
            return ""
        self._behind = 0
        return "stamp repeated" if stamp_ns == self.latest_ns else ""

    def _is_repeated(self, stamp_ns: int, raw: bytes) -> bool:
        """Whether a pose is the last one, bit for bit, which no measurement with noise ever is."""
        if raw == self._raw:
            self._repeats += 1
            return True
        self._raw, self._raw_since, self._repeats = raw, stamp_ns, 1
        return False

    def _is_reachable(self, frame: _Frame) -> bool:
        """Whether the pancake could have flown here, or has been around here for some frames."""
        if not self._frames:
            return True
        patience = self._patience if self._rejects else HISTORY  # doubt does not fade with time
        if self._gate(self._frames[-1], frame, patience):
            return True
        agrees = self._candidate is not None and self._gate(self._candidate, frame, HISTORY)
        self._agree = self._agree + 1 if agrees else 1
        self._candidate = frame
        if self._agree < REACQUIRE:
            return False
        self.counts["found again"] += 1
        self._since = frame.stamp_ns
        return True

    def _gate(self, last: _Frame, frame: _Frame, patience: int) -> bool:
        dt = min(frame.stamp_ns - last.stamp_ns, patience) * 1e-9
        step = math.dist(frame.position, last.position)
        return step <= self._settings.speed_max * dt + 5.0 * self._settings.noise

    def _accept(self, frame: _Frame) -> TrackedState | None:
        self._rejects = self._agree = 0
        self._candidate = None
        self._frames.append(frame)
        while frame.stamp_ns - self._frames[0].stamp_ns > HISTORY:
            self._frames.popleft()
        self.validity, self.fault = Validity.OK, ""
        self.counts["accepted"] += 1
        self._state = self._estimate(frame)
        return self._state

    def _estimate(self, last: _Frame) -> TrackedState | None:
        recent: list[_Frame] = []
        for frame in reversed(self._frames):
            if frame.stamp_ns < max(last.stamp_ns - self._window, self._since):
                break
            recent.append(frame)
        if len(recent) < 2:
            return None
        t = np.array([(frame.stamp_ns - last.stamp_ns) * 1e-9 for frame in recent])  # (n,)
        t -= t.mean()
        slope = t / t.dot(t)  # (n,) of the line least squares fits
        inverse = last.quat_xyzw * np.array([-1.0, -1.0, -1.0, 1.0])
        turns = [
            rotations.rotation_vector(rotations.multiply(frame.quat_xyzw, inverse))
            for frame in recent
        ]  # (n, 3)
        return TrackedState(
            last.stamp_ns,
            last.position,
            last.quat_xyzw,
            velocity=slope @ np.array([frame.position for frame in recent]),
            angular_velocity=slope @ rotations.continuous(turns),
            variance=self._settings.noise**2,
            validity=Validity.OK,
        )


def _pose_fault(position: np.ndarray, quat_xyzw: np.ndarray) -> str:
    """Why a pose cannot be one, or ""."""
    if position.shape != (3,) or quat_xyzw.shape != (4,):
        raise ValueError(f"pose of shapes {position.shape}, {quat_xyzw.shape}, not (3,), (4,)")
    place, turn = position.tolist(), quat_xyzw.tolist()
    if not all(map(math.isfinite, place + turn)):
        return "not finite"
    if not any(place):
        return "zero pose"
    if abs(math.hypot(*turn) - 1.0) > UNIT:
        return "quaternion not of unit length"
    return ""


class ClockOffset:
    """How late frames come after their stamps: their latency, and how far two clocks are apart.

    Over the frames of the last 5 s, however many a second: a tracker that has to wait for its turn
    finds seconds of frames that are all late, and must not take that for the clocks.
    """

    def __init__(self) -> None:
        self._frames: deque[tuple[int, int]] = deque()  # receipt, age

    def add(self, stamp_ns: int, received_ns: int) -> None:
        """Take a frame with its stamp and, by this machine's clock, its receipt [ns]."""
        frames = self._frames
        frames.append((received_ns, received_ns - stamp_ns))
        while not 0 <= received_ns - frames[0][0] <= OFFSET_WINDOW:
            frames.popleft()

    @property
    def seconds(self) -> float:
        """The age nearest to 0 [s]: what is left of it is not jitter."""
        return min((age for _, age in self._frames), key=abs, default=0) * 1e-9


def falling(path: BodyPath, span: float = 0.2) -> np.ndarray | None:
    """Acceleration of the pancake where its path is clearly a free fall.

    It must be along -z: if not, `up_axis` or `world_to_base` is wrong.

    Args:
        path: Of a rollout.
        span: Length of a parabola fitted through the frames [s].

    Returns:
        Mean over all parabolas with an acceleration within 1 m/s^2 of gravity and frames within
        2 mm rms of it [m/s^2], shape (3,); None when there are fewer than two.
    """
    found = []
    for start in path.t:
        inside = (path.t >= start) & (path.t <= start + span + 1e-6)
        t = path.t[inside] - start
        if len(t) < 5 or t[-1] < 0.8 * span or np.diff(t).max() > 0.5 * span:
            continue
        terms = np.stack([np.ones_like(t), t, 0.5 * t**2], axis=1)  # (m, 3)
        solution, *_ = np.linalg.lstsq(terms, path.position[inside], rcond=None)
        error = path.position[inside] - terms @ solution
        rms = np.sqrt(np.mean(np.sum(error**2, axis=1)))
        if rms < 2e-3 and abs(np.linalg.norm(solution[2]) - GRAVITY) < 1.0:
            found.append(solution[2])
    return np.mean(found, axis=0) if len(found) >= 2 else None
