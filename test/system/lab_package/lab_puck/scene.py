# SPDX-License-Identifier: Apache-2.0
"""The scene of `carry`: a ball in the cup of the URDF, which is led from right to left."""

from __future__ import annotations

import mujoco
import numpy as np

from hardware_sim import scene
from hardware_sim.scenes import reach


class Carry:
    """See `hardware_sim.scenes.Scene`."""

    body = "ball"
    home = reach.HOME
    home_sd = 0.008

    def __init__(self, settings) -> None:
        self._friction = settings.friction

    def build(self, spec: mujoco.MjSpec, tool: mujoco.MjsBody) -> None:
        for shape in tool.geoms:  # floor and walls of the cup hold the ball
            for name, value in scene.tool_contact(self._friction).items():
                setattr(shape, name, value)
        ball = spec.worldbody.add_body(name="ball", pos=[0.0, 0.0, 2.0])
        ball.add_freejoint(name="ball")
        ball.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[0.02, 0.0, 0.0],
            mass=0.03,
            **scene.body_contact(self._friction),
        )

    def place(self, data, position, rotation, offset) -> None:
        data.joint("ball").qpos[:3] = position + rotation @ [*offset, 0.021]
        data.joint("ball").qpos[3] = 1.0

    def script(self, rng: np.random.Generator) -> reach.ReachScript:
        return reach.reach(rng)

    def truth(self, log, now) -> dict:
        return {"off": float(np.linalg.norm(now.body[:3] - now.position))}
