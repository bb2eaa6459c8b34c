# SPDX-License-Identifier: Apache-2.0
"""Write a task and its scene, and learn it in this process: push a puck onto a mark."""

import numpy as np
from mujoco import MjsBody, MjSpec, mjtGeom

from hardware_sim.scenes import Scene
from hardware_sim.scenes.reach import ReachScript
from hardware_sim.world import World
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.errors import Effect, Error
from wam_power_ros.tasks.task import Task


class Puck(Task):
    """A puck is pushed over a table and slides on: it is to stop at a mark."""

    name, body = "puck", "puck"
    errors = (Error("beside", "m", 0.01, limit=0.03), Error("beyond", "m", 0.01, limit=0.03))
    effects = (Effect("shift_x", 0.05, {"beside": 1.0}), Effect("amplitude", 0.2, {"beyond": 0.5}))

    def observe(self, rollout: Rollout) -> dict[str, float]:
        """Where the puck stopped, from the mark."""
        x, y, _ = rollout.body.position[-1]
        return {"beside": x - 0.8, "beyond": y - 0.3}


class Table(Scene):
    """A table with the puck, and two fingers at the tool that push it."""

    body, at = "puck", (0.0, 0.09, -0.035)  # [m] from the tool, which is level

    def build(self, spec: MjSpec, tool: MjsBody) -> None:
        """Add table, fingers and puck."""
        box, ball, disc = mjtGeom.mjGEOM_BOX, mjtGeom.mjGEOM_SPHERE, mjtGeom.mjGEOM_CYLINDER
        table = {"type": box, "size": [0.4, 0.7, 0.01], "pos": [0.8, 0.2, 0.54]}
        spec.worldbody.add_geom(**table, **self.contact)
        for x in (-0.03, 0.03):
            finger = {"type": ball, "size": [0.02, 0.0, 0.0], "pos": [x, 0.03, -0.04]}
            tool.add_geom(**finger, mass=0.0, **self.contact)
        self.add_body(spec, type=disc, size=[0.04, 0.015, 0.0], mass=0.1)

    def script(self, rng: np.random.Generator) -> ReachScript:
        """Push from right to left, as a person does who stops somewhere near."""
        end = [0.78, 0.05, 0.6] + 0.03 * rng.standard_normal(3) * [1.0, 1.0, 0.0]
        return ReachScript(end, arc=np.zeros(3), duration=0.8, warp=0.0)


environment = Environment(World(Table, seed=3))
script = environment.world.scene.script(np.random.default_rng(3))
taught = Puck.demonstration_of(environment.arm, *environment.demonstrate(script, "taught"))
policy = Puck.policy_of([taught], "taught")
practice = Practice(preset("__main__:Puck", budget=12), {}, [policy], seed=3, arm=environment)
for record in environment.practise(practice):
    print(f"{record.number:2d} {record.kind:12s} {practice.task.outcome(record)}")
