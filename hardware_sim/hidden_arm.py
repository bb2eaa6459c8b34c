# SPDX-License-Identifier: Apache-2.0
"""Simulated arms and bodies that differ from their models, as real ones do, drawn from a seed."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import mujoco
import numpy as np

from hardware_sim.settings import WorldSettings
from wam_power_ros import rotations

GRAVITY = 9.81  # [m/s^2]
STRIBECK_SPEED = 0.05  # [rad/s] at which friction at low speed has fallen by a factor of e
_SIGN_SPEED = 0.01  # [rad/s] width of the tanh in place of the sign of a speed
_SAME_FRAME = np.eye(3), np.zeros(3)

Numbers: TypeAlias = np.ndarray | float


@dataclass(frozen=True, eq=False)
class HiddenArm:
    """Deviations of an arm with n joints from its model; without arguments there are none.

    One number stands for an array of that number, of shape (n,) where no other is given.
    """

    payload: float = 0.0  # additional mass at the tool; may be negative [kg]
    centre: Numbers = 0.0  # displacement of the tool's centre of mass in its frame [m], (3,)
    links: Numbers = 1.0  # factor on mass and inertia of each link
    friction: Numbers = 1.0  # factor on Coulomb friction
    viscous: Numbers = 1.0  # factor on viscous friction
    asymmetry: Numbers = 0.0  # share by which Coulomb friction is larger forwards than on average
    stribeck: Numbers = 0.0  # share of Coulomb friction that is added at low speed
    motors: Numbers = 1.0  # factor on the torque of each joint
    tilt: Numbers = 0.0  # of the base about its x axis and then its y axis [rad], (2,)
    zeros: Numbers = 0.0  # reported minus true position of each joint [rad]
    # Error of each joint's pose in its parent: position [m] and rotation vector [rad], (n, 6)
    geometry: Numbers = 0.0
    # Rotation (3, 3) and position (3,) [m] of the base in the frame in which the cameras see it
    cameras: tuple[np.ndarray, np.ndarray] = _SAME_FRAME

    def change(self, spec: mujoco.MjSpec, joints: Sequence[str], tool_frame: str) -> None:
        """Change masses, geometry, friction and gravity of a model before it is compiled."""
        n = len(joints)
        factors = np.broadcast_arrays(self.links, self.friction, self.viscous, np.empty(n))
        errors = np.broadcast_to(self.geometry, (n, 6))
        for name, mass, friction, viscous, error in zip(joints, *factors[:3], errors, strict=True):
            joint = spec.joint(name)
            body = joint.parent
            body.mass *= mass
            body.inertia = body.inertia * mass
            joint.frictionloss *= friction
            joint.damping *= viscous
            turn = rotations.quat_of_vector(error[3:])
            quat = np.zeros(4)
            mujoco.mju_mulQuat(quat, body.quat, turn[[3, 0, 1, 2]])
            body.pos, body.quat = body.pos + error[:3], quat
        tool = spec.body(tool_frame)
        tool.mass += self.payload
        tool.ipos = tool.ipos + self.centre
        spec.option.gravity = self.gravity

    @property
    def gravity(self) -> list[float]:
        """Gravity in the frame of the tilted base [m/s^2]; three."""
        x, y = np.broadcast_to(self.tilt, 2).tolist()
        down = [np.cos(x) * np.sin(y), -np.sin(x), -np.cos(x) * np.cos(y)]
        return [GRAVITY * each for each in down]

    @property
    def drags(self) -> bool:
        """Whether friction is anything but Coulomb and viscous."""
        return bool(np.any(self.asymmetry) or np.any(self.stribeck))

    def drag(self, qd: np.ndarray, friction: np.ndarray) -> np.ndarray:
        """Friction beyond MuJoCo's Coulomb `friction` [N m] at speeds qd [rad/s]; each (n,)."""
        slow = self.stribeck * np.exp(-((qd / STRIBECK_SPEED) ** 2))
        return friction * (self.asymmetry + slow * np.tanh(qd / _SIGN_SPEED))


def drawn(settings: WorldSettings, seed: int) -> tuple[WorldSettings, HiddenArm]:
    """Draw what is unknown by `settings.unknown`; everything is uniform in its range.

    "": nothing. "session": body mass 70 to 130 % and radius 80 to 120 % of nominal, its friction
    0.1 to 0.5, torque constants 95 to 105 %, payload up to 0.12 kg. "lab": see `_first_day`. In
    all but the first a command delay of 2 to 8 ms.
    """
    n = len(settings.model_joint_names)
    if not settings.unknown:
        return settings, HiddenArm()
    if settings.unknown == "lab":
        rng = np.random.default_rng([seed, 0x1AB])
        hidden, changes = _first_day(rng, n), {}
        delay = int(rng.integers(1, 5))
    else:
        rng = np.random.default_rng([seed, zlib.crc32(b"unknown world")])
        changes = {
            "body_mass": float(rng.uniform(0.7, 1.3)),
            "body_size": float(rng.uniform(0.8, 1.2)),
            "friction": float(rng.uniform(0.1, 0.5)),
        }
        delay = int(rng.integers(1, 5))
        hidden = HiddenArm(motors=rng.uniform(0.95, 1.05, n), payload=float(rng.uniform(0.0, 0.12)))
    changes["command_delay_ticks"] = settings.ticks(0.002 * delay)
    return settings.model_copy(update=changes), hidden


def _first_day(rng: np.random.Generator, n: int) -> HiddenArm:
    """Draw how an arm with n joints differs from its model on a laboratory's first day.

    Payload within 20 % of a tool of 0.6 kg and its centre within 10 mm, links within 5 %, Coulomb
    friction halved to doubled, viscous friction 66 to 150 %, asymmetry within 12 %, friction at low
    speed up to 20 % higher, torque constants within 5 %, zeros of 1 to 3 degrees, the base tilted
    by 1 degree and the cameras' frame off by 20 mm and 1 degree in random directions, links off by
    0.5 mm and 0.1 degrees.
    """

    def around(spread: float, size: int = n) -> np.ndarray:
        return rng.uniform(-spread, spread, size)

    def directions(*shape: int) -> np.ndarray:
        vectors = rng.standard_normal(shape)
        return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)

    return HiddenArm(
        payload=float(0.6 * rng.uniform(-0.2, 0.2)),
        centre=around(0.01, 3),
        links=1.0 + around(0.05),
        friction=2.0 ** around(1.0),
        viscous=1.5 ** around(1.0),
        asymmetry=around(0.12),
        stribeck=rng.uniform(0.0, 0.2, n),
        motors=1.0 + around(0.05),
        tilt=np.deg2rad(1.0) * directions(2),
        zeros=np.deg2rad(rng.uniform(1.0, 3.0, n)) * rng.choice([-1.0, 1.0], n),
        geometry=np.hstack([5e-4 * directions(n, 3), np.deg2rad(0.1) * directions(n, 3)]),
        cameras=(rotations.exp(np.deg2rad(1.0) * directions(3)), 0.02 * directions(3)),
    )
