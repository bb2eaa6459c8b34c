# SPDX-License-Identifier: Apache-2.0
"""An arm on a table, a wall or a ceiling: all numbers are in the link that is the base frame.

The kinematics here are computed from the text of the URDF by NumPy alone.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from hardware_sim.scenes.markers import Markers
from hardware_sim.settings import WorldSettings
from hardware_sim.wam import JOINTS
from hardware_sim.world import World
from wam_power_ros.control.arm import Arm, GuardedPoint
from wam_power_ros.control.corrections import Corrections
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import share
from wam_power_ros.view.skeleton import Skeleton

WAM = share("urdf/wam7.urdf").read_text()
STANDS = {
    "table": ((0.3, -0.2, 0.8), (0.0, 0.0, 0.8)),
    "wall": ((0.1, 1.2, 1.5), (np.pi / 2, 0.0, 0.8)),
    "slope": ((-0.5, 0.0, 0.2), (0.2, -0.5, 0.8)),
}
Pose = tuple[np.ndarray, np.ndarray]


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


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' formula."""
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew


def numbers(element: ElementTree.Element | None, name: str, default: str = "0 0 0") -> np.ndarray:
    text = default if element is None else element.get(name, default)
    return np.array([float(it) for it in text.split()])


def poses(urdf: str, q: np.ndarray) -> dict[str, Pose]:
    """Position and rotation of every link in the root of the URDF."""
    tree, angles = ElementTree.fromstring(urdf), dict(zip(JOINTS, q, strict=True))
    joints = {it.find("child").get("link"): it for it in tree.iterfind("joint")}
    found: dict[str, Pose] = {}

    def pose(link: str) -> Pose:
        if link not in joints:
            return np.zeros(3), np.eye(3)
        if link not in found:
            joint = joints[link]
            position, rotation = pose(joint.find("parent").get("link"))
            origin = joint.find("origin")
            roll, pitch, yaw = numbers(origin, "rpy")
            fixed = turn(np.eye(3)[2], yaw) @ turn(np.eye(3)[1], pitch) @ turn(np.eye(3)[0], roll)
            axis = numbers(joint.find("axis"), "xyz", "1 0 0")
            moved = turn(axis, angles.get(joint.get("name"), 0.0))
            offset = numbers(origin, "xyz")
            found[link] = position + rotation @ offset, rotation @ fixed @ moved
        return found[link]

    return {it.get("name"): pose(it.get("name")) for it in tree.iterfind("link")}


def seen_from(base: Pose, pose: Pose) -> Pose:
    return base[1].T @ (pose[0] - base[0]), base[1].T @ pose[1]


def potential(urdf: str, q: np.ndarray) -> float:
    """Potential energy [J]; the root of the URDF is upright."""
    total = 0.0
    links = poses(urdf, q)
    for link in ElementTree.fromstring(urdf).iterfind("link"):
        if (inertial := link.find("inertial")) is not None:
            position, rotation = links[link.get("name")]
            centre = position + rotation @ numbers(inertial.find("origin"), "xyz")
            total += 9.81 * float(inertial.find("mass").get("value")) * centre[2]
    return total


@pytest.mark.parametrize("stand", STANDS)
@pytest.mark.parametrize("base", ["column", "wam_base"])
def test_positions_directions_and_gravity_are_in_the_base_frame(base: str, stand: str) -> None:
    urdf, rng = mounted(*STANDS[stand]), np.random.default_rng(7)
    elbow = GuardedPoint("elbow", "wam_link4", (0.01, 0.02, 0.03))
    arm = Arm(urdf, JOINTS, "pan", (elbow,), base_frame=base)
    for _ in range(2):
        q, qd = rng.uniform(arm.q_min, arm.q_max), rng.normal(size=arm.n)
        links = poses(urdf, q)
        position, rotation = seen_from(links[base], links["pan"])
        motion = arm.motion(q, qd)
        np.testing.assert_allclose(motion.position, position, atol=1e-9)
        np.testing.assert_allclose(motion.rotation, rotation, atol=1e-9)
        at, axes = seen_from(links[base], links["wam_link4"])
        np.testing.assert_allclose(motion.guarded_positions[0], at + axes @ elbow.offset, atol=1e-9)
        later = poses(urdf, q + 1e-6 * qd)
        moved = seen_from(later[base], later["pan"])[0] - position
        np.testing.assert_allclose(motion.twist[:3], moved / 1e-6, atol=1e-4)
        step = 1e-5 * np.eye(arm.n)
        slope = [(potential(urdf, q + d) - potential(urdf, q - d)) / 2e-5 for d in step]
        np.testing.assert_allclose(arm.gravity(q), slope, atol=1e-5)


def test_an_arm_is_drawn_in_its_base_frame() -> None:
    urdf, q = mounted(*STANDS["wall"]), np.full(7, 0.2)
    shapes = {}
    for base in ("world", "wam_base"):
        drawn = Skeleton(urdf, JOINTS, base)
        arm = Arm(urdf, JOINTS, base_frame=base)
        np.testing.assert_allclose(drawn.placements(q)[0][-1], arm.tool_pose(q)[0], atol=1e-9)
        shapes[base] = next(it.placement for it in drawn.shapes if it.parentJoint == 0)
    mount = seen_from(poses(urdf, q)["wam_base"], (np.zeros(3), np.eye(3)))
    there = mount[0] + mount[1] @ shapes["world"].translation
    np.testing.assert_allclose(shapes["wam_base"].translation, there, atol=1e-9)


@pytest.mark.parametrize("base", ["world", "wam_base"])
def test_a_measured_tilt_is_that_of_the_upright_root(base: str) -> None:
    urdf = mounted((0.0, 0.0, 0.8), (0.0, 0.0, 0.8))
    tilt = Corrections.of(7, base_tilt=(0.05, -0.02))
    q = np.full(7, 0.3)
    tilted = Arm(urdf, JOINTS, "pan", (), tilt, base)
    np.testing.assert_allclose(
        tilted.gravity(q), Arm(urdf, JOINTS, "pan", (), tilt).gravity(q), atol=1e-12
    )
    assert np.abs(tilted.gravity(q) - tilted.driver_gravity(q)).max() > 0.1


def test_the_base_is_a_link_that_does_not_move_with_the_arm() -> None:
    urdf = mounted(*STANDS["table"])
    with pytest.raises(ValueError, match=r"no link 'banana'.*known: \['world'.*'wam_base'"):
        Arm(urdf, JOINTS, "pan", (), base_frame="banana")
    with pytest.raises(ValueError, match=r"base_frame 'wam_link2' moves with joint .*'wam_base'\]"):
        Arm(urdf, JOINTS, "pan", (), base_frame="wam_link2")


def test_a_policy_for_one_base_frame_is_not_one_for_another() -> None:
    urdf, named = mounted(*STANDS["table"]), Arm(WAM, JOINTS, base_frame="wam_base")
    world, base = (Arm(urdf, JOINTS, base_frame=it).identity() for it in ("world", "wam_base"))
    assert world != base and base.kinematics == Arm(WAM, JOINTS).identity().kinematics
    assert named.identity() == Arm(WAM, JOINTS).identity()  # the root by its name


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
        position, rotation = seen_from(poses(file.read_text(), q)[base], (np.zeros(3), np.eye(3)))
        tool = poses(file.read_text(), q)["pan"]
        site = world.data.body("pan").xpos
        np.testing.assert_allclose(site, position + rotation @ tool[0], atol=1e-6)
        world.data.qvel[:] = 0.0
        mujoco.mj_forward(world.model, world.data)
        np.testing.assert_allclose(world.data.qfrc_bias[:7], world.arm.gravity(q), atol=1e-4)
