# SPDX-License-Identifier: Apache-2.0
"""Simulated arms that differ from the controller's model, as real ones do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from wam_power_ros import rotations

GRAVITY = 9.81  # [m/s^2]
STRIBECK_SPEED = 0.05  # [rad/s] at which friction at low speed has fallen by a factor of e
_SIGN_SPEED = 0.01  # [rad/s] width of the tanh in place of the sign of a speed


@dataclass(frozen=True, eq=False)
class HiddenArm:
    """Deviations of an arm with n joints from its model.

    Attributes:
        payload: Additional mass at the tool; may be negative [kg].
        centre: Displacement of the tool's centre of mass in its frame [m]. Shape (3,).
        links: Factor on mass and inertia of each link. Shape (n,).
        friction: Factor on the Coulomb friction of each joint. Shape (n,).
        viscous: Factor on the viscous friction of each joint. Shape (n,).
        asymmetry: Share by which Coulomb friction is larger forwards than on average. Shape (n,).
        stribeck: Share of Coulomb friction that is added at low speed. Shape (n,).
        motors: Factor on the torque of each joint. Shape (n,).
        tilt: Rotation of the base about its x axis and then its y axis [rad]. Shape (2,).
        zeros: Reported minus true position of each joint [rad]. Shape (n,).
        geometry: Error of each joint's pose in its parent: position [m] and rotation vector [rad].
            Shape (n, 6).
        cameras: Rotation (3, 3) and position (3,) [m] of the base in the frame in which the cameras
            see it.
        delay: Time from a command until the motors' torque [s].
    """

    payload: float
    centre: np.ndarray
    links: np.ndarray
    friction: np.ndarray
    viscous: np.ndarray
    asymmetry: np.ndarray
    stribeck: np.ndarray
    motors: np.ndarray
    tilt: np.ndarray
    zeros: np.ndarray
    geometry: np.ndarray
    cameras: tuple[np.ndarray, np.ndarray]
    delay: float

    @classmethod
    def of(cls, n: int, **values: Any) -> HiddenArm:  # noqa: ANN401 - numbers of any kind
        """An arm with n joints that differs from its model in these values alone."""
        neutral = {
            "payload": 0.0,
            "centre": np.zeros(3),
            **{name: np.ones(n) for name in ("links", "friction", "viscous", "motors")},
            **{name: np.zeros(n) for name in ("asymmetry", "stribeck", "zeros")},
            "tilt": np.zeros(2),
            "geometry": np.zeros((n, 6)),
            "cameras": (np.eye(3), np.zeros(3)),
            "delay": 0.0,
        }
        return cls(**(neutral | values))

    def change(self, spec: mujoco.MjSpec, joints: Sequence[str], tool_frame: str) -> None:
        """Change masses, geometry, friction and gravity of a model before it is compiled."""
        tool = spec.body(tool_frame)
        for row, name in enumerate(joints):
            joint = spec.joint(name)
            body = joint.parent
            body.mass *= self.links[row]
            body.inertia = body.inertia * self.links[row]
            joint.frictionloss *= self.friction[row]
            joint.damping *= self.viscous[row]
            turn = rotations.quat_of_vector(self.geometry[row, 3:])
            quat = np.zeros(4)
            mujoco.mju_mulQuat(quat, body.quat, turn[[3, 0, 1, 2]])
            body.pos, body.quat = body.pos + self.geometry[row, :3], quat
        tool.mass += self.payload
        tool.ipos = tool.ipos + self.centre
        x, y = self.tilt.tolist()
        down = [np.cos(x) * np.sin(y), -np.sin(x), -np.cos(x) * np.cos(y)]
        spec.option.gravity = [GRAVITY * each for each in down]

    def drag(self, qd: np.ndarray, friction: np.ndarray) -> np.ndarray:
        """Friction [N m], shape (n,), beyond the Coulomb friction of MuJoCo.

        Args:
            qd: Speeds [rad/s]. Shape (n,).
            friction: Coulomb friction [N m]. Shape (n,).
        """
        slow = self.stribeck * np.exp(-((qd / STRIBECK_SPEED) ** 2))
        return friction * (self.asymmetry + slow * np.tanh(qd / _SIGN_SPEED))


def hidden_arm(seed: int, n: int, tool_mass: float = 0.6) -> HiddenArm:
    """Draw how an arm differs from its model on a laboratory's first day.

    Uniform: payload within 20 % of the tool and its centre within 10 mm, links within 5 %, Coulomb
    friction halved to doubled, viscous friction 66 to 150 %, asymmetry within 12 %, friction at low
    speed up to 20 % higher, torque constants within 5 %, zeros of 1 to 3 degrees, the base tilted
    by 1 degree and the cameras' frame off by 20 mm and 1 degree in random directions, links off by
    0.5 mm and 0.1 degrees, a delay of 2 to 8 ms.

    Args:
        seed: Seed of the arm.
        n: Number of joints.
        tool_mass: Mass of the tool [kg].
    """
    rng = np.random.default_rng([seed, 0x1AB])

    def around(spread: float, size: int = n) -> np.ndarray:
        return rng.uniform(-spread, spread, size)

    def direction(size: int = 3) -> np.ndarray:
        vector = rng.standard_normal(size)
        return vector / np.linalg.norm(vector)

    return HiddenArm(
        payload=float(tool_mass * rng.uniform(-0.2, 0.2)),
        centre=around(0.01, 3),
        links=1.0 + around(0.05),
        friction=2.0 ** around(1.0),
        viscous=1.5 ** around(1.0),
        asymmetry=around(0.12),
        stribeck=rng.uniform(0.0, 0.2, n),
        motors=1.0 + around(0.05),
        tilt=np.deg2rad(1.0) * direction(2),
        zeros=np.deg2rad(rng.uniform(1.0, 3.0, n)) * rng.choice([-1.0, 1.0], n),
        geometry=np.hstack(
            [
                5e-4 * np.stack([direction() for _ in range(n)]),
                np.deg2rad(0.1) * np.stack([direction() for _ in range(n)]),
            ]
        ),
        cameras=(rotations.exp(np.deg2rad(1.0) * direction()), 0.02 * direction()),
        delay=0.002 * int(rng.integers(1, 5)),
    )
