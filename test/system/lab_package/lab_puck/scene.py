# SPDX-License-Identifier: Apache-2.0
import numpy as np
from mujoco import mjtGeom

from hardware_sim.scenes import Scene
from hardware_sim.scenes.reach import ReachScript


class Table(Scene):
    """A table with the puck in front of the fork, whose shapes are those of its URDF."""

    body, at = "puck", (0.0, 0.09, -0.035)  # [m] from the tool, which is level

    def build(self, spec, tool):
        table = {"type": mjtGeom.mjGEOM_BOX, "size": [0.4, 0.7, 0.01], "pos": [0.8, 0.2, 0.54]}
        spec.worldbody.add_geom(**table, **self.contact)
        for shape in tool.geoms:
            for name, value in self.contact.items():
                setattr(shape, name, value)
        self.add_body(spec, type=mjtGeom.mjGEOM_CYLINDER, size=[0.04, 0.015, 0.0], mass=0.1)

    def script(self, rng):
        end = [0.78, 0.05, 0.6] + 0.03 * rng.standard_normal(3) * [1.0, 1.0, 0.0]
        return ReachScript(end, arc=np.zeros(3), duration=0.8, warp=0.0)

    def truth(self, log, now):
        return {"stopped": now.body[:2].tolist()}
