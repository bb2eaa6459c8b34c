# SPDX-License-Identifier: Apache-2.0
"""Simulated sensors: joint encoders with a filtered velocity, and motion capture."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hardware_sim.motors import joint_motion, motor_motion
from hardware_sim.wam import ENCODER_COUNTS, VELOCITY_CUTOFF
from wam_power_ros import rotations
from wam_power_ros.tracking.marker_fit import LAYOUT

if TYPE_CHECKING:
    from hardware_sim.tag_film import Camera

_COUNTS_PER_RAD = ENCODER_COUNTS / math.tau  # of a motor's encoder
_COUNT = math.tau / ENCODER_COUNTS  # [rad]


def _quantize_geared(q: Sequence[float]) -> tuple[float, ...]:
    """Joint positions [rad] quantized by motor encoders behind gears of 1:100."""
    return tuple([_COUNT / 100 * round(_COUNTS_PER_RAD * 100 * position) for position in q])


def _quantize_wam(q: Sequence[float]) -> tuple[float, ...]:
    """Joint positions [rad] quantized by the encoders of the WAM's motors; seven."""
    return joint_motion(
        [_COUNT * round(_COUNTS_PER_RAD * position) for position in motor_motion(q)]
    )


class Encoders:
    """Joint encoders, read every `period` [s]; velocities are low-passed as in libbarrett.

    Attributes:
        q: Joint positions [rad]; empty before `reset`.
        qd: Joint velocities [rad/s].
    """

    def __init__(self, drives: Literal["wam", "direct"], period: float) -> None:
        self._quantize = _quantize_wam if drives == "wam" else _quantize_geared
        self._keep = math.exp(-VELOCITY_CUTOFF * period)
        self._gain = (1.0 - self._keep) / period
        self.q: tuple[float, ...] = ()
        self.qd: tuple[float, ...] = ()

    def reset(self, q: Sequence[float]) -> None:
        """Reset to rest at joint positions [rad]."""
        self.q = self._quantize(q)
        self.qd = (0.0,) * len(self.q)

    def read(self, q: Sequence[float]) -> None:
        """Read the joint positions [rad] one period after the last ones."""
        now, before, keep, gain = self._quantize(q), self.q, self._keep, self._gain
        rows = zip(self.qd, now, before, strict=True)
        self.qd = tuple([keep * qd + gain * (new - old) for qd, new, old in rows])
        self.q = now


class MocapSettings(BaseModel):
    """Settings of motion capture, as config/optitrack_sim.yaml describes them with their units.

    The defaults are the paper's, else typical of present systems.

    Raises:
        ValueError: A value is out of range.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    rate: float = Field(30.0, ge=1.0, le=500.0, description="in Hz: frame rates of cameras")
    noise: float = Field(0.0005, ge=0.0, le=1.0, description="in m: beyond, nothing is measured")
    latency: float = Field(0.04, ge=0.0, le=1.0, description="in s: more is a broken network")
    dropout: float = Field(0.01, ge=0.0, le=1.0, description="a share of the frames")
    occlusion: float = Field(0.0, ge=0.0, le=1.0, description="a share of the frames")
    lost: Literal["omit", "repeat", "zero"] = "omit"
    single_marker: bool = False
    camera: bool = False
    ball_radius: float = Field(0.018, ge=0.005, le=0.2, description="in m: in the hand")


class MocapFrame(NamedTuple):
    """One frame of the tracked body, as delivered."""

    stamp_ns: int  # time of exposure
    position: np.ndarray  # (3,) [m]
    quat_xyzw: np.ndarray  # (4,); identity for a single marker
    markers: np.ndarray  # (m, 3) [m]; fewer when some are hidden, none when the frame is lost


class Mocap:
    """Motion capture of a body: noisy markers and a pose fitted to them, with latency.

    The markers are those of `LAYOUT`, all at z = 0; a single one has a position alone.
    """

    def __init__(self, settings: MocapSettings) -> None:
        self._layout = layout = np.zeros((1, 3)) if settings.single_marker else np.array(LAYOUT)
        self._centre = layout.mean(axis=0)
        self._flat = (layout - self._centre)[:, :2]
        self._mean = np.full(len(layout), 1.0 / len(layout))
        self._settings = settings
        self._period_ns = round(1e9 / settings.rate)
        self._latency_ns = round(settings.latency * 1e9)
        self._rng = np.random.default_rng(0)
        self._camera: Camera | None = None
        self._waiting: list[MocapFrame] = []
        self._last: MocapFrame | None = None  # last frame that was not lost
        self._next_ns = 0

    def aim(self, place: np.ndarray) -> None:
        """Set the camera up, if there is one, to look above a place (3,) [m]."""
        if self._settings.camera:
            from hardware_sim.tag_film import Camera  # needs OpenCV

            ball = self._settings.ball_radius if self._settings.single_marker else 0.0
            self._camera = Camera(place, ball)

    def restart(self, now_ns: int, rng: np.random.Generator) -> None:
        """Restart the frame clock: from now on, phase and noise depend on `rng` alone."""
        self._rng = rng
        if self._camera is not None:
            self._camera.forget()
        self._waiting = [frame for frame in self._waiting if frame.stamp_ns < now_ns]
        self._next_ns = now_ns + 5_000_000 + int(rng.uniform(0.0, self._period_ns))

    def forget(self) -> None:
        """Discard undelivered frames."""
        self._waiting = []

    def due(self, now_ns: int) -> bool:
        """Whether the next frame is due."""
        return now_ns >= self._next_ns

    def expose(
        self,
        now_ns: int,
        position: np.ndarray,
        rotation: np.ndarray,
        twist: np.ndarray | None = None,
    ) -> None:
        """Take the due frame of a body at `position` (3,) [m] with `rotation` (3, 3).

        Its `twist` (6,) [m/s, rad/s], None at rest, blurs the image of a camera.
        """
        self._next_ns += self._period_ns
        if self._camera is not None:
            with contextlib.suppress(ValueError):
                place, turned = self._camera.pose(now_ns, position, rotation, twist, self._rng)
                quat_xyzw = rotations.quat_xyzw(turned)
                seen = place[np.newaxis] if self._settings.single_marker else np.empty((0, 3))
                self._waiting.append(MocapFrame(now_ns, place, quat_xyzw, seen))
            return
        settings, rng = self._settings, self._rng
        count = len(self._layout)
        noise = rng.standard_normal((count, 3)) * settings.noise
        lost, hidden, which = rng.random(), rng.random(), int(rng.integers(count))
        if lost < settings.dropout:
            self._lose(now_ns)
            return
        markers = position + self._layout.dot(rotation.T) + noise
        fitted = _flat_fit(self._flat, markers) if count > 1 else np.eye(3)
        centre = self._mean.dot(markers) - fitted.dot(self._centre)
        if hidden < settings.occlusion:
            markers = np.delete(markers, which, axis=0)
        quat_xyzw = rotations.quat_xyzw(fitted)
        self._last = MocapFrame(now_ns, centre, quat_xyzw, markers)
        self._waiting.append(self._last)

    def miss(self, now_ns: int) -> None:
        """Take the due frame without seeing the body."""
        self._next_ns += self._period_ns
        self._lose(now_ns)

    def _lose(self, now_ns: int) -> None:
        how, last = self._settings.lost, self._last
        if how == "zero":
            nowhere = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])
            self._waiting.append(MocapFrame(now_ns, *nowhere, np.empty((0, 3))))
        elif how == "repeat" and last is not None:
            self._waiting.append(last._replace(stamp_ns=now_ns, markers=np.empty((0, 3))))

    def delivered(self, now_ns: int) -> list[MocapFrame]:
        """Remove and return the frames to deliver by now, oldest first."""
        if not self._waiting or self._waiting[0].stamp_ns + self._latency_ns > now_ns:
            return []
        due = [f for f in self._waiting if f.stamp_ns + self._latency_ns <= now_ns]
        self._waiting = self._waiting[len(due) :]
        return due


def _flat_fit(flat: np.ndarray, markers: np.ndarray) -> np.ndarray:
    """Least-squares rotation (3, 3) of coplanar markers: completed polar factor of a 3 x 2 matrix.

    `flat` (m, 2) is where they are in the body's frame, relative to their mean, `markers` (m, 3)
    where they were measured [m].
    """
    (ax, bx), (ay, by), (az, bz) = markers.T.dot(flat).tolist()
    aa = ax * ax + ay * ay + az * az
    ab = ax * bx + ay * by + az * bz
    bb = bx * bx + by * by + bz * bz
    root = math.sqrt(aa * bb - ab * ab)  # of the determinant of S = ((aa, ab), (ab, bb))
    scale = 1.0 / (root * math.sqrt(aa + bb + 2.0 * root))
    p, q, r = scale * (bb + root), -scale * ab, scale * (aa + root)  # S^-1/2 = ((p, q), (q, r))
    xx, xy, xz = p * ax + q * bx, p * ay + q * by, p * az + q * bz
    yx, yy, yz = q * ax + r * bx, q * ay + r * by, q * az + r * bz
    zx, zy, zz = xy * yz - xz * yy, xz * yx - xx * yz, xx * yy - xy * yx
    return np.array(((xx, yx, zx), (xy, yy, zy), (xz, yz, zz)))
