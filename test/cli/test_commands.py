# SPDX-License-Identifier: Apache-2.0
"""The commands refuse invalid requests before anything starts, and say what to do instead."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_samples import DEMO, NAMES, QOS, START, WAM, joint_state
from conftest import ROOT
from rclpy.node import Node
from std_srvs.srv import Trigger
from toss_task import demonstrated_policy, record_of, session_of

from wam_power_ros import arm_identity
from wam_power_ros.arm_identity import ArmIdentity
from wam_power_ros.bags import layout
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.cli import main
from wam_power_ros.cli.commands import _has_ended
from wam_power_ros.cli.launcher import Devices, learner_is_running
from wam_power_ros.cli.parser import goal_value
from wam_power_ros.cli.plan import DOMAIN_FILE
from wam_power_ros.cli.session_options import (
    SessionOptions,
    chosen,
    learner_parameters,
    with_origin,
)
from wam_power_ros.learning.policy import to_json
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface
from wam_power_ros.ros.outcomes import Answer, Code, fill

URDF = (ROOT / "urdf/wam7.urdf").read_text()


def test_the_task_of_a_demonstration_is_read_from_the_bag_and_not_from_its_name(
    tmp_path: Path, refusal: Callable[..., str]
) -> None:
    writer = BagWriter(tmp_path / "mine")
    writer.event("start", "reach", START)
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    writer.write("/joint_states", START, joint_state(START, WAM, np.zeros(7)))
    writer.close({})
    assert "mine is a demonstration of reach" in refusal("learn", "--bags", "mine")
    said = refusal("learn", "--task", "reach", "--bags", "mine", "none")
    assert "none is not a bag" in said


def test_feedback_without_a_learner_answers_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = session_of(tmp_path / "s", preset("flip"), 0)
    with Session.open(folder):
        assert learner_is_running(folder)
    monkeypatch.delattr("wam_power_ros.cli.commands.session_domain")  # no DDS is reached
    assert main.main(["feedback", "reward", "--session", str(folder)]) == 2
    assert "no learner is running" in capsys.readouterr().err


def test_an_arm_is_stopped_while_no_learner_runs(
    server: Node, domain_id: int, tmp_path: Path
) -> None:
    asked: list[object] = []

    def stop(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        asked.append(request)
        return fill(response, Answer(Code.DONE, "holds"))

    server.create_service(Trigger, interface.STOP, stop)
    folder = session_of(tmp_path / "s", preset("flip"), 0)
    (folder / "logs").mkdir()
    (folder / "logs" / DOMAIN_FILE).write_text(str(domain_id))
    assert main.main(["stop", "--session", str(folder)]) == 0 and len(asked) == 1


def test_a_session_that_has_ended_prints_how_to_continue_and_starts_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = preset("flip", budget=3, confirm=0, retests=1)
    assert not _has_ended(read(session_of(tmp_path / "one", settings, 1)))
    folder = session_of(tmp_path / "s", settings, 10, demonstrations=["a", "b"])
    (folder / "report.html").touch()
    monkeypatch.delattr("wam_power_ros.cli.commands.launch")  # no node is started
    assert main.main(["learn", "--session", str(folder)]) == 0
    said = " ".join(capsys.readouterr().out.split())  # its lines are as long as the terminal
    assert "has ended" in said and "1 re-tests succeeded" in said
    assert f"learn --from {folder}" in said


def test_a_session_whose_final_policy_cannot_be_executed_has_a_report_without_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = session_of(tmp_path / "s", preset("flip", budget=3, confirm=0), 0)
    with Session.open(folder) as session:
        session.append(record_of(truth={"caught": True}))
    why = "policy answer-quiet belongs to another arm"
    monkeypatch.setattr("wam_power_ros.cli.commands.find_library", lambda name: name)
    monkeypatch.setattr("wam_power_ros.cli.commands._last_error", lambda command, gl: why)
    assert main.main(["report", str(folder)]) == 0
    assert f"No film in the report: {why}" in capsys.readouterr().out
    assert "Learning curve" in (folder / "report.html").read_text()
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr("wam_power_ros.cli.commands.find_library", lambda name: None)
    assert main.main(["report", str(folder)]) == 0
    assert "No film in the report: MuJoCo draws with EGL: apt install" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "needed"),
    [("demonstration", "a bag"), ("reward some_bag", "nothing"), ("rate 10", "a number")],
)
def test_feedback_takes_a_bag_or_a_rating_only_where_it_needs_one(
    words: str, needed: str, refusal: Callable[..., str]
) -> None:
    assert f"{words.split()[0]} needs {needed}" in refusal("feedback", *words.split())


@pytest.mark.parametrize(
    ("command", "wrong"),
    [
        ("learn --session", "urdf: urdf/cobot7.urdf"),
        ("teach --folder", "tool_frame: typo"),
        ("replay bag --folder", "base_frame: typo"),
    ],
)
def test_a_set_up_that_does_not_fit_its_urdf_is_refused_before_anything_starts(
    command: str, wrong: str, tmp_path: Path, refusal: Callable[..., str]
) -> None:
    file = tmp_path / "my_arm.yaml"
    file.write_text(f"torque_controller:\n  ros__parameters:\n    {wrong}\n")
    message = refusal(*command.split(), "folder", "--config", str(file), "--simulate")
    assert "in the robot description" in message
    assert "(torque_controller: urdf, model_joint_names, base_frame, tool_frame, " in message


@pytest.mark.requirement("S-59")
def test_a_bag_of_another_arm_is_not_replayed(tmp_path: Path, refusal: Callable[..., str]) -> None:
    theirs = ArmIdentity("cobot7", NAMES, "a" * 64, "b" * 64)
    writer = BagWriter(tmp_path / "demo")
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    writer.write("/joint_states", START, joint_state(START, NAMES, np.zeros(3)))
    path = writer.close({"arm": arm_identity.to_json(theirs)})
    assert "belongs to another arm: cobot7" in refusal("replay", str(path), "--folder", "replay")


@pytest.mark.requirement("S-111")
def test_a_set_up_whose_links_have_no_mass_is_not_printed(
    tmp_path: Path, refusal: Callable[..., str]
) -> None:
    urdf = re.sub("<inertial>.*?</inertial>", "", URDF, flags=re.DOTALL)
    (tmp_path / "arm.urdf").write_text(urdf)
    file = tmp_path / "my_arm.yaml"
    file.write_text("torque_controller:\n  ros__parameters:\n    urdf: arm.urdf\n")
    message = refusal("config", "--config", str(file))
    assert f"{tmp_path / 'arm.urdf'}: links ['wam_link1'," in message
    assert "'pan'] move without mass" in message


@pytest.fixture
def origin(tmp_path: Path) -> Path:
    """Session in whose folder a policy was learnt."""
    folder = session_of(tmp_path / "simulated", preset("flip"), 1, demonstrations=[str(DEMO)])
    (folder / "policy.json").write_text(to_json(demonstrated_policy()))
    return folder


def test_a_session_from_another_one_has_its_task_demonstrations_and_policy(origin: Path) -> None:
    asked = with_origin(SessionOptions(origin=origin), Devices())
    given = learner_parameters(origin.parent / "new", asked, 0, asked.task or "")
    assert asked.task == "flip"
    assert given["demonstrations"] == read(origin).header.demonstrations
    assert given["policy"] == str(origin / "policy.json")
    assert with_origin(SessionOptions(task="reach"), Devices()).origin is None
    many = replace(asked, bags=[*asked.bags] * 3, trials=2)  # its policy alone is reproduced
    assert chosen(origin.parent / "new", many, Devices()) == (0, "flip")


def test_a_session_from_another_one_is_refused_where_that_does_not_fit(
    origin: Path, refusal: Callable[..., str]
) -> None:
    given = ("learn", "--from", str(origin))
    assert "is one of flip, not of reach" in refusal(*given, "--task", "reach")
    assert "brings its own demonstrations: omit --bags" in refusal(*given, "--bags", str(DEMO))
    assert "a goal of flip is apex, not 'y'" in refusal(*given, "--goal", "y=0.3")
    assert "--goal needs the session to predict from" in refusal("learn", "--goal", "y=0.3")
    for wrong in ("y", "y=", "=1", "y=nan", "y=near"):
        with pytest.raises(argparse.ArgumentTypeError, match="is not NAME=NUMBER"):
            goal_value(wrong)
    (origin / "policy.json").unlink()
    assert "has learnt no policy yet" in refusal(*given)


def test_what_is_not_asked_for_is_left_to_the_set_up(tmp_path: Path) -> None:
    given = learner_parameters(tmp_path, SessionOptions(trials=9), 0, "reach")
    assert given["trials"] == 9 and not {"learner", "preset", "minutes"} & given.keys()
