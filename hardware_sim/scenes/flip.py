# SPDX-License-Identifier: Apache-2.0
"""Scene of pancake flipping: pan, pancake, demonstrated toss, and outcome of a toss."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from hardware_sim.contact import WALLS, add_vessel
from hardware_sim.demonstrator import PAUSE, Target
from hardware_sim.ground_truth import RolloutLog, Snapshot, Truth, rotation_of
from hardware_sim.scenes import Scene
from hardware_sim.settings import PITCH_RATE, WorldSettings
from wam_power_ros import rotations
from wam_power_ros.tasks.flip.frames import DELTA_H, PAN_RADIUS, PANCAKE_RADIUS
from wam_power_ros.tasks.flip.settings import TRUE_TURN

BODY = "pancake"
HALF_HEIGHT = 0.0025  # [m] of the pancake
MASS = 0.026  # [kg] of the pancake, as in the paper
TILT = math.radians(25.0)  # [rad] of the pan at HOME, front edge down
DIP_TIME = 0.3  # [s] from a level pan to that tilt
HOME = np.deg2rad([0.0, 20.0, 0.0, 122.0, 0.0, -27.0, 0.0])  # [rad] pan tilted by TILT
LEVEL = np.deg2rad([0.0, 20.0, 0.0, 122.0, 0.0, -52.0, 0.0])  # [rad] pan level
HOME.setflags(write=False)
LEVEL.setflags(write=False)
WRIST_TO_PAN = 0.34  # [m] from the wrist to the pan's centre
RIM_HEIGHT = 0.035  # [m]
RIM_FLARE = 0.6  # [rad] outward: as of a real pan; a catch tolerates some centimetres


class Flip(Scene):
    """Scene of pancake flipping, see `Scene`."""

    body = BODY

    def __init__(self, settings: WorldSettings) -> None:
        super().__init__(settings)
        self.home = LEVEL if settings.level else HOME

    def build(self, spec: mujoco.MjSpec, tool: mujoco.MjsBody) -> None:
        """Add the pan, and the pancake, white above and yellow below as in the paper."""
        add_pan(tool, self.contact)
        radius = PANCAKE_RADIUS * self.settings.body_size
        body = self.add_body(
            spec,
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[radius, HALF_HEIGHT, 0.0],
            mass=MASS * self.settings.body_mass,
            rgba=[0.95, 0.78, 0.25, 1.0],
        )
        for sign, colour in ((1.0, [0.97, 0.97, 0.95, 1.0]), (-1.0, [0.96, 0.70, 0.10, 1.0])):
            body.add_geom(  # visual only
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                size=[0.97 * radius, 0.0004, 0.0],
                pos=[0.0, 0.0, sign * (HALF_HEIGHT + 0.0002)],
                mass=0.0,
                rgba=colour,
                contype=0,
                conaffinity=0,
            )

    def place(
        self, data: mujoco.MjData, position: np.ndarray, rotation: np.ndarray, offset: np.ndarray
    ) -> None:
        """Place the pancake in the pan."""
        pancake = data.joint(BODY).qpos
        pancake[:3] = position + rotation @ [*offset, 0.003]
        mujoco.mju_mat2Quat(pancake[3:], rotation.ravel())

    def script(self, rng: np.random.Generator) -> TossScript:
        """Draw a random toss."""
        settings = self.settings
        return wrist_flick(rng, settings.spread, settings.pitch_rate, settings.level)

    heading = Scene.outward

    def truth(self, log: RolloutLog, now: Snapshot) -> Truth:
        """Outcome of a toss.

        * caught: The pancake now lies flat on the pan's floor (centre under 12 mm, |cos| over .98).
        * flipped: It lies on the other side than at the release.
        * tossed: It rose above `DELTA_H` and fell below it again.
        * t_f: Time at which it fell below [s since the release]; None if not tossed.
        * angle_deg: Unwrapped rotation from rest until then about the axis of the throw [degrees].
        * true_flip: Caught, flipped, and turned by `TRUE_TURN` in the air.
        * apex: Highest point above the pan's initial height [m].
        * landing_error: Position of pancake minus pan at t_f, along x and y [m]; two.
        """
        height = log.body[:, 2]
        error, angle, t_f = [0.0, 0.0], 0.0, None
        landing = _landing(height - log.tool[:, 2])
        if landing is not None:
            t_f = (landing + 1) * log.period
            error = (log.body[landing, :2] - log.tool[landing, :2]).tolist()
            angle = math.degrees(_turned(log, landing))
        caught, flipped = _caught_flipped(now, log.start)
        start = log.start.position[2]
        return {
            "caught": caught,
            "flipped": flipped,
            "tossed": landing is not None,
            "t_f": t_f,
            "angle_deg": angle,
            "true_flip": caught and flipped and TRUE_TURN[0] <= angle <= TRUE_TURN[1],
            "apex": float(height.max(initial=start) - start),
            "landing_error": error,
        }


def add_pan(tool: mujoco.MjsBody, contact: dict[str, object]) -> None:
    """Add a pan without mass to the tool: a floor, and a flared rim of boxes."""
    width = np.pi * (PAN_RADIUS + RIM_HEIGHT * np.tan(RIM_FLARE)) / WALLS
    contact = contact | {"rgba": [0.13, 0.13, 0.14, 1.0]}
    add_vessel(tool, "pan", PAN_RADIUS, RIM_HEIGHT, width, RIM_FLARE, 0.004, **contact)


def _caught_flipped(now: Snapshot, start: Snapshot) -> tuple[bool, bool]:
    """Whether the pancake lies flat in the pan, and whether on its other side than at the start."""
    pan = now.rotation
    x, y, z = (pan.T @ (now.body[:3] - now.position)).tolist()
    cosine = _upright(now)
    flat = abs(z) < 0.012 and abs(cosine) > 0.98 and math.hypot(x, y) < PAN_RADIUS
    return flat, cosine * _upright(start) < 0.0


def _upright(snapshot: Snapshot) -> float:
    """Cosine between the normals of pancake and pan: 1 as placed, -1 upside down."""
    return float(rotation_of(snapshot.body)[:, 2] @ snapshot.rotation[:, 2])


def _turned(log: RolloutLog, end: int) -> float:
    """Unwrapped rotation angle of the pancake's normal from the release to row `end` [rad]."""
    normal_start = rotation_of(log.start.body)[:, 2]
    quat_xyzw = log.body[: end + 1, [4, 5, 6, 3]]
    x, y, z, w = quat_xyzw.T
    normals = np.stack(
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1
    )
    begin = max(0, end - round(0.1 / log.period))  # the last 0.1 s of the flight
    omega = rotations.matrix(quat_xyzw[begin:]) @ log.body_twist[begin : end + 1, 3:, None]
    axis = omega.mean(axis=0)[:, 0]
    axis -= (axis @ normal_start) * normal_start  # without spin about the normal
    length = float(np.linalg.norm(axis))
    if length < 1e-6:
        return 0.0
    axis /= length
    across = np.cross(axis, normal_start)
    # Not its sign: a rim may turn the spin at the end, and with it the axis.
    return abs(float(np.unwrap(np.arctan2(normals @ across, normals @ normal_start))[-1]))


def _landing(height: np.ndarray) -> int | None:
    """First index after the apex with a height below `DELTA_H`; None without a toss."""
    risen = np.flatnonzero(height > DELTA_H)
    if len(risen) == 0:
        return None
    up = int(risen[0])
    down = np.flatnonzero(height[up:] < DELTA_H)
    stop = up + int(down[0]) if len(down) else len(height)
    apex = up + int(np.argmax(height[up:stop]))
    under = np.flatnonzero(height[apex:] < DELTA_H)
    return apex + int(under[0]) if len(under) else None


@dataclass(frozen=True)
class TossScript:
    """Planar toss: keyframes of wrist position and pan pitch, relative to the initial pose."""

    t: np.ndarray  # times of the keyframes, the first at 0 [s], (n,)
    wrist: np.ndarray  # position, x outward and z up [m], (n, 2)
    wrist_speed: np.ndarray  # [m/s], (n, 2)
    pitch: np.ndarray  # of the pan, front edge up [rad], (n,)
    pitch_rate: np.ndarray  # [rad/s], (n,)

    @property
    def end(self) -> float:
        """See `Script`."""
        return float(self.t[-1])

    def target(self, t: float, position: np.ndarray, rotation: np.ndarray) -> Target:
        """See `Script`."""
        at = min(t, self.end)
        x, z = self._wrist(at)
        vx, vz = self._wrist(at, 1) if t < self.end else (0.0, 0.0)
        rate = float(self._pitch(at, 1)) if t < self.end else 0.0
        # the front edge rises when the pan turns about -y
        turn = rotations.exp(np.array([0.0, -float(self._pitch(at)), 0.0]))
        wrist = position - WRIST_TO_PAN * rotation[:, 0]
        rotation = turn @ rotation
        lever = WRIST_TO_PAN * rotation[:, 0]
        omega = np.array([0.0, -rate, 0.0])
        velocity = np.array([vx, 0.0, vz]) + np.cross(omega, lever)
        return Target(wrist + np.array([x, 0.0, z]) + lever, rotation, velocity, omega)

    @cached_property
    def _wrist(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.t, self.wrist, self.wrist_speed)

    @cached_property
    def _pitch(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.t, self.pitch, self.pitch_rate)


def wrist_flick(
    rng: np.random.Generator,
    spread: float = 1.0,
    pitch_rate: float = PITCH_RATE,
    level: bool = False,
) -> TossScript:
    """Draw a toss from the wrist: flick the front edge up, follow the pancake, cushion its fall.

    It begins at `HOME` with the pan tilted forward, so that the pancake rests against the front of
    the rim and a flick throws it the same way every time. From a level pan the front edge is dipped
    first, and the pancake slides there.

    `spread` scales the differences between tosses: 0 for the intended toss, 1 for a person's.
    `pitch_rate` [rad/s] is intended at the release; `level` begins at `LEVEL`, the pancake in the
    middle of the pan.
    """

    def scatter(sd: float, *shape: int) -> np.ndarray:
        return spread * sd * rng.standard_normal(shape)

    durations = np.array([0.22, 0.30, 0.35]) * (1.0 + scatter(0.06, 3))  # rise, follow, cushion [s]
    wrist = np.array([[0.03, 0.02], [0.03, 0.08], [0.0, 0.02]]) + scatter(0.012, 3, 2)
    wrist_speed = np.array([0.75, 0.3]) + scatter(0.15, 2)
    pitch = np.deg2rad([35.0, 30.0, 22.0]) + scatter(np.deg2rad(4.0), 3)  # from the tilted pan
    rate = pitch_rate * (1.0 + float(scatter(0.08)))
    dips, tilt = ([DIP_TIME], TILT) if level else ([], 0.0)
    begin = 1 + len(dips)  # keyframes at rest before the toss, minus one
    still = np.zeros((begin + 1, 2))
    return TossScript(
        np.concatenate([[0.0], PAUSE + np.concatenate([[0.0], np.cumsum([*dips, *durations])])]),
        np.vstack([still, wrist]),
        np.vstack([still, wrist_speed, np.zeros((2, 2))]),
        np.concatenate([np.zeros(begin), [-tilt], pitch - tilt]),
        np.concatenate([np.zeros(begin + 1), [rate, 0.0, 0.0]]),
    )
