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
from toss_task import demonstrated_policy, practice_of, toss

from wam_power_ros import arm_identity
from wam_power_ros.arm_identity import ArmIdentity
from wam_power_ros.bags import layout
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.cli import main
from wam_power_ros.cli.commands import _has_ended
from wam_power_ros.cli.launcher import Devices, learner_is_running
from wam_power_ros.cli.parser import goal_value
from wam_power_ros.cli.session_options import (
    SessionOptions,
    chosen,
    learner_parameters,
    with_origin,
)
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.settings import preset

URDF = (ROOT / "urdf/wam7.urdf").read_text()


@pytest.mark.parametrize("task", ["flip", "reach"])
def test_the_task_of_a_demonstration_is_read_from_the_bag_and_not_from_its_name(
    task: str, tmp_path: Path, refusal: Callable[..., str]
) -> None:
    writer = BagWriter(tmp_path / "mine")
    writer.event("start", "reach", START)
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    writer.write("/joint_states", START, joint_state(START, WAM, np.zeros(7)))
    writer.close({})
    message = "mine is a demonstration of reach" if task == "flip" else "none is not a bag"
    assert message in refusal("learn", "--task", task, "--bags", "mine", "none")


def test_feedback_without_a_learner_answers_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, folder = preset("flip"), tmp_path / "s"
    with Session.begin(folder, settings, 5, [demonstrated_policy()]):
        assert learner_is_running(folder)
    monkeypatch.delattr("wam_power_ros.cli.commands.session_domain")  # no DDS is reached
    assert main.main(["feedback", "reward", "--session", str(folder)]) == 2
    assert "no learner is running" in capsys.readouterr().err


def test_a_session_that_has_ended_prints_how_to_continue_and_starts_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, policies = preset("flip", budget=3, confirm=0, retests=1), [demonstrated_policy()]
    practice, folder = practice_of(policies, settings, seed=0), tmp_path / "s"
    with Session.begin(folder, settings, 0, policies, demonstrations=["a", "b"]) as session:
        while (trial := practice.next_trial()) is not None:
            assert not _has_ended(read(folder))
            session.append(practice.learn_assessed(trial, toss(trial, practice.task.settings)))
    (folder / "report.html").touch()
    monkeypatch.delattr("wam_power_ros.cli.commands.launch")  # no node is started
    assert main.main(["learn", "--session", str(folder)]) == 0
    said = " ".join(capsys.readouterr().out.split())  # its lines are as long as the terminal
    assert "has ended" in said and "1 re-tests succeeded" in said
    assert f"learn --from {folder}" in said


def test_a_session_whose_final_policy_cannot_be_executed_has_a_report_without_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, policies = preset("flip", budget=3, confirm=0), [demonstrated_policy()]
    practice, folder = practice_of(policies, settings, seed=0), tmp_path / "s"
    with Session.begin(folder, settings, 0, policies) as session:
        trial = practice.next_trial()
        record = practice.learn_assessed(trial, toss(trial, practice.task.settings))
        session.append(record.model_copy(update={"truth": {"caught": True}}))
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
    folder, policy = tmp_path / "simulated", demonstrated_policy()
    settings = preset("flip")
    with Session.begin(folder, settings, 0, [policy], demonstrations=[str(DEMO)]) as session:
        practice = practice_of([policy], settings, seed=0)
        trial = practice.next_trial()
        session.append(practice.learn_assessed(trial, toss(trial, practice.task.settings)))
        session.save_policy(policy)
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
