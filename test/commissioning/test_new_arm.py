# SPDX-License-Identifier: Apache-2.0
"""A first set-up from a URDF alone: complete, without a mistake, and with reasons."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from wam_power_ros.cli import main
from wam_power_ros.cli.set_up_checks import mistakes
from wam_power_ros.commissioning.new_arm import SPEED_SHARE, chain, reach_of, room_of, way_of
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.urdf_checks import parsed
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import share


def test_what_is_proposed_for_an_arm_is_a_set_up_without_a_mistake(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(share("urdf/openarm.urdf"), urdf := tmp_path / "mine.urdf")
    assert main.main(["new-arm", str(urdf), "--output", "position"]) == 0
    assert "not yet right" not in capsys.readouterr().out
    file = tmp_path / "mine.yaml"
    values = [line for line in file.read_text().splitlines() if line.startswith("    ")]
    assert len(values) > 15 and all("  # " in line for line in values)
    setup = overlay.setup([str(file)], task="reach")
    assert setup["torque_controller"]["tool_frame"] == "openarm_pan"
    assert setup["torque_controller"]["output"] == "position"
    assert not [*mistakes(setup)]
    model = setup.arm()
    assert model is not None
    assert model.tool_pose(np.array(setup["wam_sim"]["home"]))[1][2, 2] > 0.99
    assert main.main(["new-arm", str(urdf)]) == 2  # exists


def test_a_joint_that_turns_without_end_gets_limits_which_all_parts_of_the_set_up_keep(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = share("urdf/ur5e.urdf").read_text()
    wrist = '<joint name="wrist_3_joint" type="revolute">'
    assert wrist in text
    text = text.replace(wrist, wrist.replace("revolute", "continuous"))
    (urdf := tmp_path / "mine.urdf").write_text(text)
    assert main.main(["new-arm", str(urdf), "--output", "position"]) == 0
    assert "not yet right" not in capsys.readouterr().out
    setup = overlay.setup([str(tmp_path / "mine.yaml")], task="reach")
    limits = setup["torque_controller"]["position_limits"]
    assert limits == [*[0.0] * 10, -2.99, 2.99]
    for node in ("wam_sim", "demonstration_recorder"):
        assert setup[node]["position_limits"] == limits
    environment = Environment.from_setup(setup)  # controller and stand-in
    assert environment.controller.limits.q_max[-1] == environment.world.arm.q_max[-1] == 2.99


def test_the_tool_is_moved_by_the_most_joints_and_no_finger() -> None:
    joint = '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{0}_link"/></joint>'
    joints = [("j1", "revolute", "base"), ("j2", "revolute", "j1_link")]
    joints += [("hand", "fixed", "j2_link"), ("tcp", "fixed", "hand_link")]
    joints += [("finger", "prismatic", "hand_link")]
    links = ["base", *(f"{name}_link" for name, *_ in joints)]
    text = "".join(
        [f'<link name="{link}"/>' for link in links] + [joint.format(*j) for j in joints]
    )
    tree = parsed(f"<robot>{text}</robot>")
    assert chain(tree) == (["j1", "j2"], ["base", "j1_link", "j2_link"], "tcp_link")
    assert chain(tree, "finger_link")[0] == ["j1", "j2", "finger"]
    for tool, said in (("gripper", "no link 'gripper'"), ("base", "no joint moves")):
        with pytest.raises(ValueError, match=said):
            chain(tree, tool)


def test_a_joint_of_a_gripper_is_no_joint_of_the_arm() -> None:
    joint = '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{0}_l"/>{2}</joint>'
    for jaw, follower in (("left_jaw", ""), ("drive", '<mimic joint="drive"/>')):
        joints = [("j1", "base", ""), ("j2", "j1_l", ""), (jaw, "j2_l", "")]
        joints += [("other_finger", f"{jaw}_l", follower)]
        links = ["base", *(f"{name}_l" for name, *_ in joints)]
        text = "".join([f'<link name="{link}"/>' for link in links])
        text += "".join(joint.format(*each) for each in joints)
        tree = parsed(f"<robot>{text}</robot>")
        assert chain(tree)[0] == ["j1", "j2"]
        assert chain(tree, f"{jaw}_l")[0] == ["j1", "j2", jaw]  # asked for by name


@pytest.mark.parametrize("slow", [1.0, 0.5])
def test_a_proposed_reach_keeps_speed_limits_of_slow_arms_too(slow: float) -> None:
    arm = arm_of("ur5e.urdf", "pan")
    arm.qd_max *= slow
    home, _, way = reach_of(arm, 0.5, np.random.default_rng(0))
    path = way_of(arm, home, way)
    assert path is not None and 0.0 < room_of(arm, path, 0.5)
    assert np.all(np.abs(np.diff(path, axis=0)) / 0.2 < SPEED_SHARE * arm.qd_max)
    assert all(arm.tool_pose(q)[0][2] > 0.0 for q in path)


def test_a_posture_that_is_singular_or_at_the_table_leaves_no_room() -> None:
    arm = arm_of("ur5e.urdf", "pan")
    bent = np.array([0.0, -1.6, 1.9, -1.9, -1.6, 0.0])
    straight, low = bent.copy(), bent.copy()
    straight[2], low[1] = 0.0, -0.1
    rooms = [room_of(arm, np.array([q, q]), 1.0) for q in (bent, straight, low)]
    assert rooms[0] > 0.05 > abs(rooms[1]) and rooms[2] == -1.0


def test_a_proposed_reach_is_far_from_singularities() -> None:
    arm = arm_of("ur5e.urdf", "pan")
    home, _, way = reach_of(arm, 1.0, np.random.default_rng(0))
    path = way_of(arm, home, way)
    assert path is not None
    assert min(np.linalg.svd(arm.jacobian(q))[1][-1] for q in path) > 0.05


def test_an_arm_of_five_joints_which_cannot_hold_its_orientation_has_a_reach_as_well() -> None:
    arm = arm_of("ur5e.urdf", "pan", joints=5)
    home, _, way = reach_of(arm, 0.5, np.random.default_rng(0))
    path = way_of(arm, home, way)
    assert path is not None
    assert arm.tool_pose(path[-1])[0] == pytest.approx(arm.tool_pose(home)[0] + way, abs=2e-3)


def test_an_arm_that_cannot_move_fast_enough_is_refused_with_the_reason() -> None:
    arm = arm_of("ur5e.urdf", "pan")
    arm.qd_max *= 0.01
    with pytest.raises(ValueError, match="was found above"):
        reach_of(arm, 0.5, np.random.default_rng(0))


def arm_of(urdf: str, tool: str, joints: int = 6) -> Arm:
    text = share(f"urdf/{urdf}").read_text()
    names = chain(parsed(text), tool)[0][:joints]
    return Arm(text, names, tool, ())
