# SPDX-License-Identifier: Apache-2.0
"""The command `run-policy` on the stand-in: executed, recorded, scored; refused; stopped."""

from __future__ import annotations

import dataclasses
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import ROOT, lift
from toss_task import demonstrated_policy

from wam_power_ros.arm_identity import ArmIdentity
from wam_power_ros.bags import layout
from wam_power_ros.cli import main
from wam_power_ros.console.run_policy import task_of
from wam_power_ros.learning.policy import to_json
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.settings import preset


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    file = tmp_path / "policy.json"
    file.write_text(to_json(lift("lift")))
    return file


def running(*arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "wam_power_ros.cli", "run-policy", *map(str, arguments)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, cwd=ROOT, stdout=pipe, stderr=subprocess.STDOUT, text=True)


def test_each_return_is_that_of_its_bag_and_ctrl_c_leaves_an_arm_that_holds_and_bags_closed(
    saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    process = running(saved, "--rollouts", 100, "--folder", tmp_path / "run")
    said = ""
    for line in process.stdout:
        said += line
        if line.startswith("2 of 100"):
            break
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    said += process.stdout.read()
    assert process.wait(600.0) == 130, said
    assert "Stopped: the arm holds." in said
    lines = re.findall(r"^(\d) of 100: return ([\d.]+), .*recorded: (\w+)$", said, re.M)
    assert [line[0] for line in lines][:2] == ["1", "2"], said
    for _, ret, bag in lines:
        assert main.main(["score", str(tmp_path / "run/bags" / bag)]) == 0
        assert f"return {ret}, " in capsys.readouterr().out
    assert not [*(tmp_path / "run/bags").glob(f"*{layout.UNFINISHED}")]


def test_two_policies_are_executed_by_turns_and_a_pair_is_judged(
    saved: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.json"
    other.write_text(to_json(dataclasses.replace(lift("other"), damping=20.0)))
    command = [sys.executable, "-m", "wam_power_ros.cli", "compare", saved, other, "--pairs", 2]
    words = [*map(str, command), "--folder", str(tmp_path / "run")]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=900.0)
    assert done.returncode == 0, done.stdout + done.stderr
    lines = re.findall(r"^(\d) of 2, ([AB]): return ([\d.]+)", done.stdout, re.M)
    assert [line[:2] for line in lines] == [("1", "A"), ("1", "B"), ("2", "B"), ("2", "A")]
    (standing,) = re.findall(r"pairs won: A (\d), B (\d).*not known", done.stdout)[-1:]
    returns = {(number, name): float(ret) for number, name, ret in lines}
    clear = [returns[n, "A"] - returns[n, "B"] for n in "12"]
    if min(map(abs, clear)) > 1e-3:  # printed returns tell who has won
        assert standing == (str(sum(d > 0 for d in clear)), str(sum(d < 0 for d in clear)))
    assert len([*(tmp_path / "run/bags").iterdir()]) == 4


def test_a_comparison_without_returns_is_refused(refusal: Callable[..., str], saved: Path) -> None:
    said = refusal("compare", "policy.json", "policy.json", "--task", "reach")
    assert "without returns nothing can be compared: task reach measures" in said


def test_what_is_no_policy_of_this_arm_is_refused_before_any_node_starts(
    refusal: Callable[..., str], saved: Path, tmp_path: Path
) -> None:
    assert "No such file" in refusal("run-policy", "none.json")
    (tmp_path / "text.json").write_text("{}")
    assert "text.json is not a policy: " in refusal("run-policy", "text.json")
    (tmp_path / "text.json").write_bytes(b"\xff\xfe")
    assert "text.json is not a policy: " in refusal("run-policy", "text.json")
    theirs = ArmIdentity("other", tuple("abcdefg"), "0" * 64, "0" * 64)
    saved.write_text(to_json(dataclasses.replace(lift("lift"), arm=theirs)))
    assert "policy lift belongs to another arm" in refusal("run-policy", "policy.json")


def test_replay_names_the_command_for_a_policy(refusal: Callable[..., str], saved: Path) -> None:
    assert "to execute a policy: " in (said := refusal("replay", "policy.json"))
    assert "run-policy policy.json" in said and "recover" not in said


def test_the_task_is_that_of_the_session_else_of_its_first_preset(tmp_path: Path) -> None:
    settings = preset("flip", "paper", budget=3)
    Session.begin(tmp_path / "s", settings, 0, [demonstrated_policy()]).close()
    session = read(tmp_path / "s")
    task, why = task_of(session, "flip")
    assert (task.name, task.settings, why) == ("flip", settings.task_settings, "")
    assert task_of(None, "flip")[0].settings == preset("flip").task_settings
    task, why = task_of(session, "reach")  # measures by its demonstrations
    assert task is None and "run the policy in its folder" in why
