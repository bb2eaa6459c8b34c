# SPDX-License-Identifier: Apache-2.0
"""Scenes: the surroundings of the arm in a task, one module per task.

A scene is found by its entry point in the group `wam_power_ros.scenes`, so that other packages can
provide scenes.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from hardware_sim.contact import body_contact, tool_contact
from hardware_sim.demonstrator import Demonstrator, Script
from hardware_sim.ground_truth import RolloutLog, Snapshot, Truth
from hardware_sim.settings import WorldSettings
from wam_power_ros import installed

HOME = np.deg2rad([-29.5, 27.2, 0.0, 116.3, -35.3, -58.9, 20.1])  # [rad] tool level, right
HOME.setflags(write=False)


class Scene:
    """Bodies around the arm, shapes of the tool, demonstrations, and ground truth of a rollout.

    Derive from it; by default nothing is around the arm, and nothing is demonstrated.

    Attributes:
        body: Name of the tracked MuJoCo body, on a free joint unless it is mounted; "" for none.
            Topics and services are named after it. A class attribute.
        has_goal: Whether its demonstrations end at the `goal` of the settings. A class attribute.
        at: Initial position of the body in the frame of the tool [m], three numbers.
        home: Posture of the WAM in which demonstrations begin [rad], shape (7,); that of another
            arm is a parameter of `wam_sim`.
        home_sd: Standard deviation of that posture, per joint [rad].
        mounted: Position (3,) [m] and rotation (3, 3) at the tool of a tracked body that is fixed
            to it and no part of the model; None for one on a free joint.
        settings: Settings of the world.
    """

    body: str = ""
    has_goal: bool = False
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    home: np.ndarray = HOME
    home_sd: float = 0.0
    mounted: tuple[np.ndarray, np.ndarray] | None = None

    def __init__(self, settings: WorldSettings) -> None:
        self.settings = settings

    @property
    def contact(self) -> dict[str, object]:
        """Geom arguments of a shape, of the tool or the surroundings, that touches the body."""
        return tool_contact(self.settings.friction)

    def add_body(self, spec: mujoco.MjSpec, **shape: object) -> mujoco.MjsBody:
        """Add the tracked body, which air slows down, to a model; `shape`: of its geom."""
        body = spec.worldbody.add_body(name=self.body, pos=[0.0, 0.0, 2.0])
        body.add_freejoint(name=self.body)
        shape |= body_contact(self.settings.friction)
        body.add_geom(name=self.body, fluid_ellipsoid=1, **shape)
        return body

    def build(self, spec: mujoco.MjSpec, tool: mujoco.MjsBody) -> None:
        """Add bodies to the model of the arm, and shapes that touch them to its tool.

        Without these the tool touches nothing: the shapes of the URDF, whose link has the mass, are
        only drawn.
        """

    def place(
        self, data: mujoco.MjData, position: np.ndarray, rotation: np.ndarray, offset: np.ndarray
    ) -> None:
        """Put the bodies to their initial positions; they settle before a rollout begins.

        By default the body is put to `at`, displaced by a random offset (2,) [m] in the x-y plane
        of the tool, upright in the base frame. The state is just reset, the arm in its start
        posture, the tool at a position (3,) [m] with a rotation (3, 3).
        """
        if self.body and self.mounted is None:
            data.joint(self.body).qpos[:3] = position + rotation @ np.add(self.at, [*offset, 0.0])

    def script(self, rng: np.random.Generator) -> Script:
        """Draw a random demonstration; a ValueError if there are none."""
        raise ValueError(f"the scene {type(self).__name__} has no demonstrations")

    def demonstrator(
        self, script: Script, position: np.ndarray, rotation: np.ndarray
    ) -> Demonstrator:
        """Demonstrator of a script, from a position (3,) [m] and rotation (3, 3) of the tool."""
        return Demonstrator(script, position, rotation, self.heading(position))

    def heading(self, position: np.ndarray) -> float:
        """Direction about the vertical [rad] of what a script begins at a position (3,) [m] as x.

        By default it is that of the base, for scripts that know where they go.
        """
        return 0.0

    def outward(self, position: np.ndarray) -> float:
        """Heading away from the base [rad], to a whole degree."""
        return math.radians(round(math.degrees(math.atan2(position[1], position[0]))))

    def truth(self, log: RolloutLog, now: Snapshot) -> Truth:
        """Outcome of a rollout, from its log and the current state."""
        return {}


def scene_type(name: str) -> type[Scene]:
    """Class of the scene with this name; raises a ValueError as `installed.find` does."""
    found: type[Scene] = installed.find("scene", name)
    return found
