# SPDX-License-Identifier: Apache-2.0
"""The demonstrator: its targets, forces and release."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hardware_sim.demonstrator import FORCE_MAX, MOMENT_MAX, Demonstrator, Script
from hardware_sim.scenes.ball_in_cup import swing
from hardware_sim.scenes.flip import wrist_flick
from hardware_sim.scenes.reach import reach
from hardware_sim.settings import ArmSimParams
from hardware_sim.world import World
from wam_power_ros import rotations
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import share

POSITION, ROTATION = np.array([0.8, 0.0, 0.6]), rotations.exp(np.array([0.0, 0.4, 0.0]))
STILL = np.zeros(6)
ASIDE = np.array([0.01, 0.0, 0.0])  # [m]


def demonstrator() -> Demonstrator:
    return Demonstrator(wrist_flick(np.random.default_rng(0)), POSITION, ROTATION)


@pytest.mark.parametrize("draw", [wrist_flick, reach, swing])
def test_target_velocities_are_the_derivatives_of_target_poses(
    draw: Callable[[np.random.Generator], Script],
) -> None:
    script = draw(np.random.default_rng(3))
    step = 1e-6
    for t in np.linspace(0.01, script.end - 0.01, 50):
        before, now, after = (
            script.target(t + dt, POSITION, ROTATION) for dt in (-step, 0.0, step)
        )
        _, _, velocity, omega = now
        np.testing.assert_allclose(velocity, (after[0] - before[0]) / (2 * step), atol=1e-5)
        turned = rotations.log(after[1] @ before[1].T)
        np.testing.assert_allclose(omega, turned / (2 * step), atol=1e-5)


def test_the_demonstrator_pulls_towards_its_target_and_no_harder_than_a_person() -> None:
    hand = demonstrator()
    assert not hand.wrench(0.0, POSITION, ROTATION, STILL).any()
    aside = hand.wrench(0.0, POSITION + ASIDE, ROTATION, STILL)
    np.testing.assert_allclose(aside, [-30.0, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-9)
    turned = rotations.exp(np.array([0.0, 0.1, 0.0])) @ ROTATION
    twisted = hand.wrench(0.0, POSITION, turned, STILL)
    np.testing.assert_allclose(twisted, [0.0, 0.0, 0.0, 0.0, -6.0, 0.0], atol=1e-9)
    moving = hand.wrench(0.0, POSITION, ROTATION, np.array([0.1, 0, 0, 0, 0, 1.0]))
    np.testing.assert_allclose(moving, [-12.0, 0.0, 0.0, 0.0, 0.0, -3.0], atol=1e-9)
    torn = hand.wrench(0.0, POSITION + 1.0, rotations.exp(np.ones(3)) @ ROTATION, STILL)
    assert np.linalg.norm(torn[:3]) == pytest.approx(FORCE_MAX)
    assert np.linalg.norm(torn[3:]) == pytest.approx(MOMENT_MAX)


@pytest.mark.parametrize("joints", [6, 5])
def test_a_guided_wrist_without_rotor_inertia_is_not_shaken_nor_twisted(
    joints: int, tmp_path: Path
) -> None:
    text = re.sub(r' armature="[^"]*"', "", share("urdf/ur5e.urdf").read_text())
    text = re.sub(r'(<link name="pan">\s*)<inertial>.*?</inertial>', r"\1", text, flags=re.DOTALL)
    (urdf := tmp_path / "ur5e.urdf").write_text(text)
    setup = overlay.setup(["ur", "position"], task="reach", simulated=True)
    names = setup["torque_controller"]["model_joint_names"][:joints]
    home = setup["wam_sim"]["home"][:joints]
    changed = {"joint_names": names, "model_joint_names": names, "urdf": str(urdf)}
    setup = setup.changed({"torque_controller": changed, "wam_sim": {**changed, "home": home}})
    world = World.from_params(ArmSimParams.from_setup(setup), None)
    world.guided = True
    world.attach(
        Demonstrator(reach(np.random.default_rng(0), world.settings.goal), *world.tool_pose)
    )
    fastest = 0.0
    while world.pulled:
        world.step(np.array(home))
        fastest = max(fastest, float(np.abs(world.joint_state().qd).max()))
    assert fastest < 2.0
    assert np.linalg.norm(world.tool_pose[0] - world.settings.goal) < 0.05
