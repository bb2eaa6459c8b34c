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
from wam_power_ros.console.run_policy import task_of
from wam_power_ros.learning.policy import to_json
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.settings import preset


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    file = tmp_path / "policy.json"
    file.write_text(to_json(lift("lift")))
    return file


def test_each_rollout_has_its_return_and_ctrl_c_leaves_an_arm_that_holds_and_bags_closed(
    saved: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "wam_power_ros.cli", "run-policy", str(saved)]
    command += ["--rollouts", "100", "--folder", str(tmp_path / "run")]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, cwd=ROOT, stdout=pipe, stderr=subprocess.STDOUT, text=True)
    said = ""
    for line in process.stdout:
        said += line
        if line.startswith("1 of 100"):
            break
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    said += process.stdout.read()
    assert process.wait(600.0) == 130, said
    assert "Stopped: the arm holds." in said
    lines = re.findall(r"^(\d) of 100: return [\d.]+, .*recorded: (\w+)$", said, re.M)
    assert lines and lines[0][0] == "1", said
    bags = {path.name for path in (tmp_path / "run/bags").iterdir()}
    assert {bag for _, bag in lines} <= bags
    assert not [name for name in bags if name.endswith(layout.UNFINISHED)]


def test_what_is_no_policy_of_this_arm_is_refused_before_any_node_starts(
    refusal: Callable[..., str], saved: Path, tmp_path: Path
) -> None:
    assert "No such file" in refusal("run-policy", "none.json")
    (tmp_path / "text.json").write_text("{}")
    assert "text.json is not a policy: " in refusal("run-policy", "text.json")
    (tmp_path / "text.json").write_bytes(b"\xff\xfe")
    assert "text.json is not a policy: " in refusal("run-policy", "text.json")
    theirs = ArmIdentity("other", tuple("abcdefg"), "0" * 64, "0" * 64)
    assert "run-policy policy.json" in refusal("replay", "policy.json")
    saved.write_text(to_json(dataclasses.replace(lift("lift"), arm=theirs)))
    assert "policy lift belongs to another arm" in refusal("run-policy", "policy.json")


def test_the_task_is_that_of_the_session_else_of_its_first_preset(tmp_path: Path) -> None:
    settings = preset("flip", "paper", budget=3)
    Session.begin(tmp_path / "s", settings, 0, [demonstrated_policy()]).close()
    session = read(tmp_path / "s")
    task, why = task_of(session, "flip")
    assert (task.name, task.settings, why) == ("flip", settings.task_settings, "")
    assert task_of(None, "flip")[0].settings == preset("flip").task_settings
    task, why = task_of(session, "reach")  # measures by its demonstrations
    assert task is None and "run the policy in its folder" in why
