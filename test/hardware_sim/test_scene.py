# SPDX-License-Identifier: Apache-2.0
"""The MuJoCo model against Pinocchio and against the facts sheet of the arm."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from simulated import URDF

from hardware_sim import scene
from hardware_sim.scenes.flip import Flip
from hardware_sim.scenes.reach import Reach
from hardware_sim.wam import CABLE_LIMIT, JOINTS, MOTOR_OF_JOINT
from hardware_sim.world import World
from wam_power_ros.control.arm import Arm


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm(URDF, JOINTS)


@pytest.fixture(scope="module")
def world() -> World:
    return World(Flip, seed=3)


def test_mujoco_and_pinocchio_agree_on_the_arm_of_the_urdf(arm: Arm) -> None:
    model = scene.arm(URDF).compile()
    model.dof_damping[:] = 0.0
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    mass = np.zeros((7, 7))
    rng = np.random.default_rng(0)
    for _ in range(20):
        data.qpos[:] = rng.uniform(arm.q_min, arm.q_max)
        data.qvel[:] = rng.normal(scale=2.0, size=7)
        data.qacc[:] = qdd = rng.normal(scale=8.0, size=7)
        q, qd = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_inverse(model, data)
        mujoco.mj_fullM(model, data, mass)
        position, rotation = arm.tool_pose(q)
        np.testing.assert_allclose(data.qfrc_inverse, arm.inverse_dynamics(q, qd, qdd), atol=1e-6)
        np.testing.assert_allclose(mass, arm.mass_matrix(q), atol=1e-9)
        np.testing.assert_allclose(data.body("pan").xpos, position, atol=1e-9)
        np.testing.assert_allclose(data.body("pan").xmat.reshape(3, 3), rotation, atol=1e-9)


def test_a_gripper_is_locked_and_meshes_are_left_out() -> None:
    finger = """<link name="finger"><inertial><mass value="0.1"/>
        <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>
        <visual><geometry><mesh filename="package://lab/finger.dae"/></geometry></visual></link>
        <joint name="finger" type="prismatic"><parent link="pan"/><child link="finger"/>
        <axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="20" velocity="0.2"/></joint>"""
    model = scene.arm(URDF.replace("</robot>", f"{finger}</robot>")).compile()
    assert (model.nq, model.nmesh) == (7, 0)
    assert model.body("finger").mass == pytest.approx(0.1)


def test_an_inertia_that_is_only_nearly_a_body_and_one_that_never_moves_are_no_obstacle() -> None:
    link = """<link name="{0}"><inertial><mass value="0.1"/>
        <inertia ixx="{1}" iyy="1e-4" izz="2.2e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="{0}_joint" type="fixed"><parent link="{2}"/><child link="{0}"/></joint>"""
    added = link.format("nearly", "1e-4", "pan") + link.format("antenna", "-1e-4", "wam_base")
    model = scene.arm(URDF.replace("</robot>", f"{added}</robot>")).compile()
    assert model.body("nearly").mass == pytest.approx(0.1)
    assert model.body("antenna").mass == pytest.approx(0.1)


def test_the_arm_keeps_its_properties_in_the_scene(arm: Arm, world: World) -> None:
    model = world.model
    assert model.body_mass[1 : model.body("pancake").id].sum() == pytest.approx(
        19.459 + 9.971 + 0.6, abs=1e-3
    )
    np.testing.assert_array_equal(model.dof_armature[:7], arm.armature)
    np.testing.assert_array_equal(model.jnt_range[:7].T, [arm.q_min, arm.q_max])
    turns = np.abs(MOTOR_OF_JOINT)
    no_load_speed = world.motors.motor_no_load_speed / turns.max(axis=0)
    np.testing.assert_allclose(no_load_speed, arm.qd_max, rtol=2e-3)
    np.testing.assert_allclose(CABLE_LIMIT @ turns, arm.tau_max, rtol=4e-3)
    assert sum(model.geom_group == 1) > 10  # the shapes of the arm


def test_a_tool_touches_nothing_but_what_its_scene_gives_it(world: World) -> None:
    def touching(model: mujoco.MjModel) -> int:
        ours = model.geom_bodyid == model.body("pan").id
        return int((ours & (model.geom_contype > 0)).sum())

    assert touching(world.model) == 17  # floor and rim of the pan, for the pancake
    assert touching(World(Reach).model) == 0
