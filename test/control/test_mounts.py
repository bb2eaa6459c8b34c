# SPDX-License-Identifier: Apache-2.0
"""An arm on a table, a wall or a slope: all numbers are in the link that is the base frame."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from hardware_sim.scenes.markers import Markers
from hardware_sim.settings import WorldSettings
from hardware_sim.wam import JOINTS
from hardware_sim.world import World
from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm, GuardedPoint
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import share

WAM = share("urdf/wam7.urdf").read_text()
STANDS = {
    "table": ((0.3, -0.2, 0.8), (0.0, 0.0, 0.8)),
    "wall": ((0.1, 1.2, 1.5), (np.pi / 2, 0.0, 0.8)),
    "slope": ((-0.5, 0.0, 0.2), (0.2, -0.5, 0.8)),
}
GRAVITY = np.array([0.0, 0.0, -9.81])


def mounted(place: tuple[float, ...], rpy: tuple[float, ...]) -> str:
    """The WAM on a mount: its root is the link `world`."""
    mount = (
        '<link name="world"/><link name="column"/>'
        '<joint name="up" type="fixed"><parent link="world"/><child link="column"/>'
        '<origin xyz="0 0 0.1"/></joint><joint name="mount" type="fixed"><parent link="column"/>'
        f'<child link="wam_base"/><origin xyz="{place[0]} {place[1]} {place[2] - 0.1}" '
        f'rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/></joint>'
    )
    return WAM.replace("</robot>", f"{mount}</robot>")


def turned(rpy: tuple[float, ...]) -> np.ndarray:
    """Axes of a link in its parent, of its roll, pitch and yaw."""
    x, y, z = (rotations.exp(angle * axis) for angle, axis in zip(rpy, np.eye(3), strict=True))
    return z @ y @ x


@pytest.mark.parametrize("stand", STANDS)
@pytest.mark.parametrize("base", ["column", "wam_base"])
def test_positions_directions_and_gravity_are_in_the_base_frame(base: str, stand: str) -> None:
    place, axes = np.array(STANDS[stand][0]), turned(STANDS[stand][1])
    turn, shift = (axes, place - [0.0, 0.0, 0.1]) if base == "column" else (np.eye(3), np.zeros(3))
    elbow = GuardedPoint("elbow", "wam_link4", (0.01, 0.02, 0.03))
    arm = Arm(mounted(*STANDS[stand]), JOINTS, "pan", (elbow,), base_frame=base)
    plain, rng = Arm(WAM, JOINTS, "pan", (elbow,)), np.random.default_rng(7)
    upright = plain.model.copy()
    upright.gravity.linear = axes.T @ GRAVITY
    for _ in range(2):
        q, qd = rng.uniform(arm.q_min, arm.q_max), rng.normal(size=arm.n)
        motion, alone = arm.motion(q, qd), plain.motion(q, qd)
        for found, expected in (
            (motion.position, turn @ alone.position + shift),
            (motion.rotation, turn @ alone.rotation),
            (motion.guarded_positions[0], turn @ alone.guarded_positions[0] + shift),
            (motion.twist, np.concatenate([turn @ alone.twist[:3], turn @ alone.twist[3:]])),
            (arm.gravity(q), pin.computeGeneralizedGravity(upright, upright.createData(), q)),
        ):
            np.testing.assert_allclose(found, expected, atol=1e-9)


def test_the_base_is_a_link_that_does_not_move_with_the_arm() -> None:
    urdf = mounted(*STANDS["table"])
    with pytest.raises(ValueError, match=r"no link 'banana'.*known: \['world'.*'wam_base'"):
        Arm(urdf, JOINTS, "pan", (), base_frame="banana")
    with pytest.raises(ValueError, match=r"base_frame 'wam_link2' moves with joint .*'wam_base'\]"):
        Arm(urdf, JOINTS, "pan", (), base_frame="wam_link2")


def test_every_frame_of_a_set_up_is_a_link(tmp_path: Path) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text("pancake_tracker: {ros__parameters: {base_frame: banana}}")
    with pytest.raises(ValueError, match=r"'banana' of pancake_tracker.*'wam_base'"):
        overlay.setup([str(file)])
    for key in ("base_frame", "tool_frame"):
        file.write_text(f"torque_controller: {{ros__parameters: {{{key}: banana}}}}")
        with pytest.raises(ValueError, match=r"no link 'banana' .*known: .*'wam_base'.*base_frame"):
            overlay.setup([str(file)]).arm()


def test_the_simulated_arm_hangs_as_its_model_says(tmp_path: Path) -> None:
    file = tmp_path / "mounted.urdf"
    file.write_text(mounted(*STANDS["slope"]))
    settings = {"urdf": str(file), "wind_sd": 0.0, "torque_scale_sd": 0.0, "friction_sd": 0.0}
    for base in ("world", "wam_base"):
        world = World(Markers, WorldSettings(base_frame=base, **settings))
        q = world.data.qpos[:7].copy()
        site = world.data.body("pan").xpos
        np.testing.assert_allclose(site, world.arm.tool_pose(q)[0], atol=1e-6)
        world.data.qvel[:] = 0.0
        mujoco.mj_forward(world.model, world.data)
        np.testing.assert_allclose(world.data.qfrc_bias[:7], world.arm.gravity(q), atol=1e-4)
