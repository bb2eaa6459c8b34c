# SPDX-License-Identifier: Apache-2.0
"""Simulated demonstrator: guides the tool along a scripted movement, as a person would by hand.

A spring-damper pulls the tool towards the target pose; the arm only carries its own weight. The
scene of a task provides the scripts.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from wam_power_ros import rotations

STIFFNESS = 3000.0  # [N/m]
DAMPING = 120.0  # [N s/m]
ROTATION_STIFFNESS = 60.0  # [N m/rad]
ROTATION_DAMPING = 3.0  # [N m s/rad]
GRIP_DAMPING = np.repeat((DAMPING, ROTATION_DAMPING), 3)  # of velocity and angular velocity
FORCE_MAX = 150.0  # [N] of a person's arm
MOMENT_MAX = 15.0  # [N m]
PAUSE = 0.25  # [s] at rest before a movement
RELEASE_TIME = 0.3  # [s] in which the grip fades out after a movement


class Target(NamedTuple):
    """Target pose and velocity of the tool."""

    position: np.ndarray  # (3,) [m]
    rotation: np.ndarray  # (3, 3)
    velocity: np.ndarray  # (3,) [m/s]
    omega: np.ndarray  # (3,) [rad/s]


class Script(Protocol):
    """A movement relative to the pose in which it begins."""

    @property
    def end(self) -> float:
        """Duration of the movement [s]."""

    def target(self, t: float, position: np.ndarray, rotation: np.ndarray) -> Target:
        """Target at time t [s] of a movement that began at `position` (3,), `rotation` (3, 3)."""


class Demonstrator:
    """Follows a script from the `position` (3,) [m] and `rotation` (3, 3) of the gripped tool."""

    def __init__(
        self, script: Script, position: np.ndarray, rotation: np.ndarray, heading: float = 0.0
    ) -> None:
        """With the script turned about the vertical by a heading [rad]."""
        self.script = script
        self._turn = rotations.exp(np.array([0.0, 0.0, heading]))
        self._position, self._rotation = self._turn.T @ position, self._turn.T @ rotation

    def wrench(
        self, t: float, position: np.ndarray, rotation: np.ndarray, twist: np.ndarray
    ) -> np.ndarray | None:
        """Force [N] and moment [N m] (6,) at the tool's origin; None once the tool is let go.

        At time t [s] since the grip the tool has this position (3,) [m], rotation (3, 3) and twist
        (6,): velocity [m/s] and angular velocity [rad/s].
        """
        release = max(t - self.script.end, 0.0)
        if release > RELEASE_TIME:
            return None
        target = self.script.target(t, self._position, self._rotation)
        p, r, v, omega = (self._turn @ each for each in target)
        grip = 1.0 - release / RELEASE_TIME
        force = STIFFNESS * (p - position) + DAMPING * (v - twist[:3])
        moment = ROTATION_STIFFNESS * rotations.log(r @ rotation.T) + ROTATION_DAMPING * (
            omega - twist[3:]
        )
        force *= grip * min(1.0, FORCE_MAX / max(float(np.linalg.norm(force)), 1e-9))
        moment *= grip * min(1.0, MOMENT_MAX / max(float(np.linalg.norm(moment)), 1e-9))
        return np.concatenate([force, moment])
