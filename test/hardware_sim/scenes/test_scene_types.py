# SPDX-License-Identifier: Apache-2.0
"""Scenes by name, and a scene of another package: a ball in the pan."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from simulated import LEVEL, holding_torque, run

from hardware_sim.contact import body_contact
from hardware_sim.ground_truth import RolloutLog, Snapshot, Truth
from hardware_sim.scenes import Scene, scene_type
from hardware_sim.scenes.flip import add_pan, wrist_flick
from hardware_sim.settings import WorldSettings
from hardware_sim.world import DROP_HEIGHT, World

RADIUS = 0.02  # [m] of the ball


class Ball(Scene):
    """A ball that rests in the pan."""

    body = "ball"
    home = LEVEL

    def build(self, spec: mujoco.MjSpec, tool: mujoco.MjsBody) -> None:
        """Add the pan, the ball, and an untracked flag on a hinge."""
        add_pan(tool, self.contact)
        still = spec.worldbody.add_body(name="stand", pos=[1.5, 0.0, 0.0])
        still.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.1])
        hinged = still.add_body(name="flag", pos=[0.0, 0.0, 0.5])
        hinged.add_joint(name="flag", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 0.0, 1.0])
        hinged.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.01, 0.1, 0.1], mass=0.1)
        body = spec.worldbody.add_body(name="ball", pos=[0.0, 0.0, 2.0])
        body.add_freejoint(name="ball")
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[RADIUS, 0.0, 0.0],
            mass=0.05,
            **body_contact(self.settings.friction),
        )

    def place(
        self, data: mujoco.MjData, position: np.ndarray, rotation: np.ndarray, offset: np.ndarray
    ) -> None:
        """Put the ball into the pan."""
        data.joint("ball").qpos[:3] = position + rotation @ [*offset, RADIUS]

    def script(self, rng: np.random.Generator) -> object:
        """A toss."""
        return wrist_flick(rng)

    def truth(self, log: RolloutLog, now: Snapshot) -> Truth:
        """Whether the ball is in the pan, and its greatest height."""
        offset = now.rotation.T @ (now.body[:3] - now.position)
        return {"held": bool(abs(offset[2] - RADIUS) < 0.01), "highest": log.body[:, 2].max()}


@pytest.fixture(scope="module")
def world() -> World:
    return World(Ball, WorldSettings(body_offset_sd=0.0))


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


def test_the_body_of_a_scene_is_tracked_and_comes_to_rest_before_a_rollout(world: World) -> None:
    world.reset("trial-0001", LEVEL)
    world.release()
    run(world, holding_torque(world), 100)
    truth, frames = world.truth(), world.mocap_frames()
    ball = world.data.joint("ball").qpos[:3]
    assert truth["held"]
    assert truth["highest"] == pytest.approx(ball[2], abs=1e-3)
    assert len(frames) > 3
    np.testing.assert_allclose(frames[-1].position, ball, atol=3e-3)
    assert list(truth)[:3] == ["id", "held", "highest"]


def test_the_body_of_a_scene_can_be_dropped(world: World) -> None:
    world.reset("trial-0001", LEVEL)
    world.release()
    before = world.data.joint("flag").qpos.copy()
    world.drop()
    height = world.data.joint("ball").qpos[2]
    assert height == pytest.approx(world.tool_pose[0][2] + DROP_HEIGHT)
    run(world, holding_torque(world), 100)  # 0.2 s
    assert height - world.data.joint("ball").qpos[2] == pytest.approx(0.5 * 9.81 * 0.04, rel=0.03)
    assert world.truth()["held"] is False
    np.testing.assert_array_equal(world.data.joint("flag").qpos, before)


def test_a_tracked_body_must_be_on_a_free_joint() -> None:
    class Fixed(Ball):
        body = "stand"

    class Hinged(Ball):
        body = "flag"

    for wrong in (Fixed, Hinged):
        with pytest.raises(ValueError, match="must be on a free joint"):
            World(wrong)


@pytest.mark.parametrize("name", ["flip", "reach", "ball_in_cup"])
def test_demonstrations_without_a_spread_are_all_the_intended_one(name: str) -> None:
    def targets(spread: float, seed: int) -> list[list[float]]:
        scene = scene_type(name)(WorldSettings(spread=spread))
        script = scene.script(np.random.default_rng(seed))
        times = np.linspace(0.0, 2.0, 7)
        return [script.target(t, np.zeros(3), np.eye(3)).position.tolist() for t in times]

    assert targets(0.0, 1) == targets(0.0, 2)
    assert targets(1.0, 1) != targets(1.0, 2)
