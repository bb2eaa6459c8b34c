# SPDX-License-Identifier: Apache-2.0
"""The demonstrating hand: pulls the pan along a toss of its own making, as a person would.

The hand is a spring-damper between the pan and a wanted pose; the arm only carries its weight. No
two demonstrations are alike: timing, reach and flick are drawn anew, and most of them miss.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from wam_power_ros import rotations

STIFFNESS = 3000.0  # [N/m]
DAMPING = 120.0  # [N s/m]
ROTATION_STIFFNESS = 60.0  # [N m/rad]
ROTATION_DAMPING = 3.0  # [N m s/rad]
FORCE_MAX = 150.0  # [N] what a person's arm gives
MOMENT_MAX = 15.0  # [N m]
REACH = 0.34  # [m] from the wrist to the pan's centre


@dataclass(frozen=True)
class HandScript:
    """A planar toss: keys of the wrist and of the pan's pitch, relative to where it begins.

    Attributes:
        t: times of the keys, the first at 0 [s]. Shape (n,)
        wrist: x outward and z up [m]. Shape (n, 2)
        wrist_speed: [m/s]. Shape (n, 2)
        pitch: of the front edge upward [rad]. Shape (n,)
        pitch_rate: [rad/s]. Shape (n,)
    """

    t: np.ndarray
    wrist: np.ndarray
    wrist_speed: np.ndarray
    pitch: np.ndarray
    pitch_rate: np.ndarray


def wrist_flick(rng: np.random.Generator, spread: float = 1.0) -> HandScript:
    """A toss from the wrist: flick the front edge up, follow under the pancake, cushion its fall.

    It begins at the world's `HOME`, the pan tilted forward and the pancake slid against the front
    of the rim, as a cook does: from there a flick throws it the same way every time. Out of a level
    pan, the pancake would slide or not slide to the rim on the way, and throws scatter by 15 cm.

    Args:
        rng: what makes this demonstration differ from the next.
        spread: 0 for the hand's intention, 1 for a person's scatter about it.
    """

    def scatter(sd: float, *shape: int) -> np.ndarray:
        return spread * sd * rng.standard_normal(shape)

    pause = 0.25  # at rest before the movement [s]
    durations = np.array([0.22, 0.30, 0.35]) * (1.0 + scatter(0.06, 3))  # rise, under, cushion [s]
    wrist = np.array([[0.03, 0.02], [0.03, 0.08], [0.0, 0.02]]) + scatter(0.012, 3, 2)
    wrist_speed = np.array([0.75, 0.3]) + scatter(0.15, 2)
    pitch = np.deg2rad([35.0, 30.0, 22.0]) + scatter(np.deg2rad(4.0), 3)
    pitch_rate = 7.6 * (1.0 + float(scatter(0.08)))
    still = np.zeros((2, 2))
    return HandScript(
        np.concatenate([[0.0], pause + np.concatenate([[0.0], np.cumsum(durations)])]),
        np.vstack([still, wrist]),
        np.vstack([still, wrist_speed, still]),
        np.concatenate([[0.0, 0.0], pitch]),
        np.array([0.0, 0.0, pitch_rate, 0.0, 0.0]),
    )


class Hand:
    """A hand that follows a script from the pose in which it takes the pan."""

    def __init__(self, script: HandScript, position: np.ndarray, rotation: np.ndarray) -> None:
        """Take the pan at `position` (3,) [m], `rotation` (3, 3)."""
        self.script = script
        self._rotation0 = rotation
        self._wrist0 = position - REACH * rotation[:, 0]
        self._wrist = CubicHermiteSpline(script.t, script.wrist, script.wrist_speed)
        self._pitch = CubicHermiteSpline(script.t, script.pitch, script.pitch_rate)
        self._end = float(script.t[-1])
        self._relax = 0.3  # [s] in which the hand lets go

    def target(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Wanted position (3,), rotation (3, 3), velocity (3,) and angular velocity (3,)."""
        at = min(t, self._end)
        x, z = self._wrist(at)
        vx, vz = self._wrist(at, 1) if t < self._end else (0.0, 0.0)
        rate = float(self._pitch(at, 1)) if t < self._end else 0.0
        # the front edge rises when the pan turns about -y
        turn = rotations.exp(np.array([0.0, -float(self._pitch(at)), 0.0]))
        rotation = turn @ self._rotation0
        lever = REACH * rotation[:, 0]
        omega = np.array([0.0, -rate, 0.0])
        velocity = np.array([vx, 0.0, vz]) + np.cross(omega, lever)
        return self._wrist0 + np.array([x, 0.0, z]) + lever, rotation, velocity, omega

    def wrench(
        self, t: float, position: np.ndarray, rotation: np.ndarray, twist: np.ndarray
    ) -> np.ndarray | None:
        """Force [N] and moment [N m] (6,) at the pan's centre; None once the hand has let go.

        Args:
            t: since the hand took the pan [s].
            position: of the pan [m]. Shape (3,)
            rotation: of the pan. Shape (3, 3)
            twist: its velocity [m/s] and angular velocity [rad/s]. Shape (6,)
        """
        if t > self._end + self._relax:
            return None
        p, r, v, omega = self.target(t)
        grip = 1.0 - max(t - self._end, 0.0) / self._relax
        force = STIFFNESS * (p - position) + DAMPING * (v - twist[:3])
        moment = ROTATION_STIFFNESS * rotations.log(r @ rotation.T) + ROTATION_DAMPING * (
            omega - twist[3:]
        )
        force *= grip * min(1.0, FORCE_MAX / max(float(np.linalg.norm(force)), 1e-9))
        moment *= grip * min(1.0, MOMENT_MAX / max(float(np.linalg.norm(moment)), 1e-9))
        return np.concatenate([force, moment])
