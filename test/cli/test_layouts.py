# SPDX-License-Identifier: Apache-2.0
"""Layouts with the joints, topics and frames of a set-up."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from conftest import ROOT

from wam_power_ros.cli import main
from wam_power_ros.cli.layouts import FILES, layout
from wam_power_ros.params import overlay

OF_THE_WAM = re.compile(r"wam_|pancake|\b/?joint_states|effort_controller/commands")


@pytest.mark.parametrize(("program", "file"), FILES.items())
def test_the_shipped_layouts_are_those_of_the_shipped_set_up(
    program: str, file: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["layout", program]) == 0
    shipped = (ROOT / "config/visualization" / file).read_text()
    assert capsys.readouterr().out == shipped


@pytest.fixture
def another() -> overlay.Setup:
    """Set-up in which no name is that of the WAM or the pancake."""
    arm = {
        "joint_names": ["a", "b", "c"],
        "base_frame": "stand",
        "state_topic": "states",
        "command_topic": "torques",
        "command_type": "joint_state",
    }
    changes = {"torque_controller": arm, "pancake_tracker": {"body": "ball"}}
    return overlay.setup(["ur"]).changed(changes)


@pytest.mark.parametrize("program", FILES)
def test_a_layout_has_no_name_of_another_arm_and_all_topics_of_the_namespace(
    program: str, another: overlay.Setup
) -> None:
    text = layout(program, another, "/left")
    assert not OF_THE_WAM.search(text)
    topics = set(re.findall(r"(?<=[\"; ])/(?:[a-z_]+/?)+", text)) - {"/diagnostics"}
    assert topics and all(topic.startswith("/left/") for topic in topics)


def test_foxglove_has_a_line_for_every_joint_and_the_frames_of_the_namespace(
    another: overlay.Setup,
) -> None:
    panels = json.loads(layout("foxglove", another, "/left"))["configById"]
    torques = panels["Plot!torque"]["paths"]
    assert [line["label"] for line in torques] == ["a", "b", "c"]
    assert torques[2]["value"] == "/left/torques.effort[2]"
    assert [line["value"][-3:] for line in panels["Plot!speed"]["paths"]] == ["[0]", "[1]", "[2]"]
    scene = panels["3D!arm"]
    assert scene["fixedFrame"] == "left/stand" and scene["layers"]["arm"]["framePrefix"] == "left/"


def test_plotjuggler_has_a_curve_for_every_joint(another: overlay.Setup) -> None:
    curves = [each.get("name", "") for each in _curves(layout("plotjuggler", another, "/left"))]
    for joint in "abc":
        assert f"/left/states/{joint}/position" in curves
        assert f"/left/torques/{joint}/effort" in curves
    assert len(curves) == 3 * 3 + 3  # angles, speeds, torques; the body


def test_a_list_of_torques_has_a_curve_for_every_place() -> None:
    names = [each.get("name", "") for each in _curves(layout("plotjuggler", overlay.setup(["ur"])))]
    torques = [name for name in names if "commands" in name]
    assert torques == [f"/forward_effort_controller/commands/data[{k}]" for k in range(6)]


def _curves(text: str) -> list[ElementTree.Element]:
    return list(ElementTree.fromstring(text.encode()).iter("curve"))


def test_rviz_shows_the_arm_of_its_namespace_in_its_frame(another: overlay.Setup) -> None:
    manager = yaml.safe_load(layout("rviz", another, "/left"))["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "left/stand"
    assert [each["TF Prefix"] for each in manager["Displays"] if "TF Prefix" in each] == ["left"]


def test_a_wrong_program_or_namespace_is_refused(
    refusal: Callable[..., str], tmp_path: Path
) -> None:
    assert "names of letters" in refusal("layout", "rviz", "--namespace", "le ft")
    assert "no set-up 'none'" in refusal("layout", "rviz", "--config", "none")
