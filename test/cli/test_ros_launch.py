# SPDX-License-Identifier: Apache-2.0
"""Launch arguments become a launch plan; test/system runs the launch files themselves."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from conftest import ROOT

from wam_power_ros.cli import launcher, ros_launch
from wam_power_ros.cli.launcher import UsageError
from wam_power_ros.params import overlay
from wam_power_ros.params.parameter_file import of_nodes

BAGS = sorted((ROOT / "bags").glob("demo_*"))
DEFAULTS = {name: default for name, (default, _) in ros_launch.SHARED_ARGUMENTS.items()}
SIM = {**DEFAULTS, "config": "", "pace": "lockstep"}


def sim(**given: object) -> ros_launch.LaunchPlan:
    return ros_launch.prepare(SIM | {name: str(value) for name, value in given.items()}, True)


def hardware(**given: object) -> ros_launch.LaunchPlan:
    values = DEFAULTS | {name: str(value) for name, value in given.items()}
    return ros_launch.prepare(values, stand_ins=False)


def test_hardware_starts_no_stand_in_and_no_torque_without_activation(tmp_path: Path) -> None:
    plan = hardware(config="geodude full_speed")
    assert set(plan.executables) == {
        "torque_controller",
        "pancake_tracker",
        "demonstration_recorder",
    }
    assert not plan.setup["torque_controller"]["autostart"]
    assert plan.setup["torque_controller"]["joint_names"][0] == "right_j1"
    with pytest.raises(ValueError, match="config is empty"):
        hardware(config=" ")
    plan = hardware(config="geodude", session=tmp_path / "s", demonstrations=BAGS[0])
    assert plan.executables[-1] == "learner"
    assert not plan.setup["learner"]["reset_faults"]


@pytest.mark.parametrize(
    ("asked", "pace"),
    [
        ({}, "lockstep"),
        ({"pace": "real_time"}, "real_time"),
        ({"config": "libbarrett"}, "real_time"),
    ],
)
def test_stand_ins_keep_the_pace_that_was_asked_for(asked: dict[str, str], pace: str) -> None:
    plan = sim(**asked)
    assert set(plan.executables) == set(overlay.NODES) - {"optitrack_sim", "learner"}
    assert plan.setup["wam_sim"]["pace"] == pace
    assert plan.setup["learner"].get("use_sim_time", False) == (pace == "lockstep")


def test_a_session_has_its_bags_in_its_folder_and_the_given_settings(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    given = {"seed": 7, "trials": 20, "learner": "cma_es", "preset": "paper"}
    plan = sim(session=folder, demonstrations=f"{BAGS[0]} {BAGS[1]}", **given)
    learner = plan.setup["learner"]
    assert {name: learner[name] for name in given} == given
    assert learner["demonstrations"] == [str(bag) for bag in BAGS[:2]]
    assert (learner["session"], plan.session) == (str(folder), folder)
    assert plan.setup["demonstration_recorder"]["directory"] == str(folder / "bags")
    assert plan.setup["wam_sim"]["seed"] == 7
    file = ros_launch.parameter_file(plan)
    assert file.is_relative_to(folder)
    assert of_nodes(file)["learner"] == learner


def test_a_path_with_a_space_is_quoted(tmp_path: Path) -> None:
    (tmp_path / "my bags").mkdir()
    bag = tmp_path / "my bags" / BAGS[0].name
    bag.symlink_to(BAGS[0].resolve())
    plan = sim(session=tmp_path / "s", demonstrations=f"'{bag}' {BAGS[1]}")
    assert plan.setup["learner"]["demonstrations"] == [str(b.resolve()) for b in BAGS[:2]]
    with pytest.raises(ValueError, match="No closing quotation"):
        sim(session=tmp_path / "s", demonstrations="'unended")


def test_a_launch_refuses_a_session_in_use_and_changes_nothing(tmp_path: Path) -> None:
    plan = sim(session=tmp_path)
    with launcher.folder_lock(tmp_path):
        domain = tmp_path / "logs" / launcher.DOMAIN_FILE
        domain.write_text("42")
        with pytest.raises(UsageError, match="another session or learner is using"):
            ros_launch.parameter_file(plan)
        assert [file.name for file in domain.parent.iterdir() if file.suffix == ".yaml"] == []
        assert domain.read_text() == "42"


def test_a_task_without_a_body_has_no_tracker(tmp_path: Path) -> None:
    for plan in (
        sim(task="reach", config="geodude", session=tmp_path),
        hardware(task="reach", config="geodude", session=tmp_path),
    ):
        assert "pancake_tracker" not in plan.executables
        assert plan.setup["learner"]["task"] == "reach"
        assert plan.setup["torque_controller"]["guarded_region"][3] > 0.0


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"task": "flop"}, "'flop' is not one of"),
        ({"learner": "luck"}, "'luck'"),
        ({"trials": "few"}, "trials 'few' must be a whole number"),
        ({"seed": "-1"}, "seed '-1' must be a whole number"),
        ({"trials": 5, "demonstrations": BAGS[0], "task": "reach"}, "demonstration of flip"),
    ],
)
def test_a_wrong_argument_is_refused_before_anything_is_started(
    given: dict[str, object], says: str, tmp_path: Path
) -> None:
    with pytest.raises((UsageError, ValueError), match=says):
        sim(session=tmp_path / "s", **given)
    assert not (tmp_path / "s").exists()


def test_without_a_session_the_parameter_file_ends_with_the_launch(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ends = []
    monkeypatch.setattr(
        ros_launch.atexit, "register", lambda *call, **also: ends.append((call, also))
    )
    file = ros_launch.parameter_file(sim())
    assert file.is_file()
    for (remove, *arguments), also in ends:
        remove(*arguments, **also)
    assert not file.parent.exists()


def test_the_description_of_the_arm_has_the_frames_and_the_clock_of_its_nodes() -> None:
    described = ros_launch.arm_description(sim(namespace="left"))
    assert described is not None
    assert described["frame_prefix"] == "left/" and described["use_sim_time"] is True
    assert '<link name="wam_base">' in str(described["robot_description"])
    alone = ros_launch.arm_description(sim(pace="real_time"))
    assert alone is not None
    assert (alone["frame_prefix"], alone["use_sim_time"]) == ("", False)
    assert ros_launch.arm_description(sim(config="geodude")) is None  # other names than its URDF's


def test_rviz_shows_the_arm_of_its_namespace() -> None:
    text = ros_launch.rviz_file("/left")
    shipped = (ROOT / "config/visualization/session.rviz").read_text()
    topics = re.findall(r"Value: (/[a-z_/]+)", shipped)
    assert re.findall(r"Value: (/[a-z_/]+)", text) == [f"/left{topic}" for topic in topics]
    assert "Fixed Frame: left/wam_base" in text and "TF Prefix: left\n" in text
    assert yaml.safe_load(ros_launch.rviz_file("")) == yaml.safe_load(shipped)
