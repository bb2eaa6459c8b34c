# SPDX-License-Identifier: Apache-2.0
"""Scenes: the surroundings of the arm in a task, one module per task.

A scene is found by its entry point in the group `wam_power_ros.scenes`, so that other packages can
provide scenes.
"""

from __future__ import annotations

from typing import Protocol

import mujoco
import numpy as np

from hardware_sim.demonstrator import Script
from hardware_sim.ground_truth import RolloutLog, Snapshot, Truth
from hardware_sim.settings import WorldSettings
from wam_power_ros import installed


class Scene(Protocol):
    """Bodies around the arm, shapes of the tool, demonstrations, and ground truth of a rollout.

    Attributes:
        body: Name of the tracked MuJoCo body, on a free joint; "" for none. Topics and services are
            named after it. A class attribute.
        home: Posture of the WAM in which demonstrations begin [rad], shape (7,); that of another
            arm is a parameter of `wam_sim`.
        home_sd: Standard deviation of that posture, per joint [rad].
    """

    body: str
    home: np.ndarray
    home_sd: float

    def __init__(self, settings: WorldSettings) -> None: ...

    def build(self, spec: mujoco.MjSpec, tool: mujoco.MjsBody) -> None:
        """Add bodies to the model of the arm, and shapes that touch them to its tool.

        Without these the tool touches nothing: the shapes of the URDF are only drawn.

        Args:
            spec: Model of the arm.
            tool: Body of the tool in it; its link in the URDF has mass and drawn shapes.
        """

    def place(
        self, data: mujoco.MjData, position: np.ndarray, rotation: np.ndarray, offset: np.ndarray
    ) -> None:
        """Put the bodies to their initial positions; they settle before a rollout begins.

        Args:
            data: State to change, just reset, the arm in its start posture.
            position: Position of the tool [m]. Shape (3,).
            rotation: Rotation of the tool. Shape (3, 3).
            offset: Random offset in the x-y plane of the tool [m]. Shape (2,).
        """

    def script(self, rng: np.random.Generator) -> Script:
        """Draw a random demonstration."""

    def truth(self, log: RolloutLog, now: Snapshot) -> Truth:
        """Outcome of a rollout, from its log and the current state."""


def scene_type(name: str) -> type[Scene]:
    """Class of the scene with this name; raises a ValueError as `installed.find` does."""
    found: type[Scene] = installed.find("scene", name)
    return found
