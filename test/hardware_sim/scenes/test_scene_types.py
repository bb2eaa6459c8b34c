# SPDX-License-Identifier: Apache-2.0
"""Scenes by name, and a scene of another package: a ball in the pan."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from hardware_sim.ground_truth import RolloutLog, Snapshot, Truth
from hardware_sim.scenes import Scene, scene_type
from hardware_sim.scenes.flip import add_pan
from hardware_sim.settings import WorldSettings
from hardware_sim.world import World


class Stone(Scene):
    """A stone that rests in the pan, and nothing else."""

    body, at = "stone", (0.03, -0.02, 0.05)

    def build(self, spec: mujoco.MjSpec, tool: mujoco.MjsBody) -> None:
        """Add the pan and the stone, which cannot roll."""
        add_pan(tool, self.contact)
        self.add_body(spec, type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02] * 3, mass=0.05)

    def truth(self, log: RolloutLog, now: Snapshot) -> Truth:
        """Where the stone is, in the frame of the tool."""
        return {"at": now.rotation.T @ (now.body[:3] - now.position)}


def test_a_scene_leaves_out_what_it_lacks() -> None:
    settings = WorldSettings(body_offset_sd=0.0)
    assert World(Stone, settings).truth()["at"] == pytest.approx([0.03, -0.02, 0.02], abs=0.002)
    empty = World(Scene, settings)
    assert empty.truth().keys() == {"id", *empty._log.arm_truth(empty.motors)}
    with pytest.raises(ValueError, match="the scene Scene has no demonstrations"):
        empty.scene.script(np.random.default_rng(0))


def test_a_tracked_body_must_be_on_a_free_joint() -> None:
    class Fixed(Scene):
        body = "stand"

        def build(self, spec: mujoco.MjSpec, tool: mujoco.MjsBody) -> None:
            spec.worldbody.add_body(name="stand", pos=[1.5, 0.0, 0.0])

        def place(self, *_: object) -> None:
            pass

    with pytest.raises(ValueError, match="must be on a free joint"):
        World(Fixed)


@pytest.mark.parametrize("name", ["flip", "reach", "ball_in_cup"])
def test_demonstrations_without_a_spread_are_all_the_intended_one(name: str) -> None:
    def targets(spread: float, seed: int) -> list[list[float]]:
        scene = scene_type(name)(WorldSettings(spread=spread))
        script = scene.script(np.random.default_rng(seed))
        times = np.linspace(0.0, 2.0, 7)
        return [script.target(t, np.zeros(3), np.eye(3)).position.tolist() for t in times]

    assert targets(0.0, 1) == targets(0.0, 2)
    assert targets(1.0, 1) != targets(1.0, 2)
