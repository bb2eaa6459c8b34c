# SPDX-License-Identifier: Apache-2.0
"""The command `run-policy` on the stand-in: executed, recorded, scored; refused; stopped."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import lift
from toss_task import session_of

from wam_power_ros.arm_identity import ArmIdentity
from wam_power_ros.console.run_policy import task_of
from wam_power_ros.learning.policy import to_json
from wam_power_ros.practice.session import read
from wam_power_ros.practice.settings import preset


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    file = tmp_path / "policy.json"
    file.write_text(to_json(lift("lift")))
    return file


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
    session = read(session_of(tmp_path / "s", settings, 0))
    task, why = task_of(session, "flip")
    assert (task.name, task.settings, why) == ("flip", settings.task_settings, "")
    assert task_of(None, "flip")[0].settings == preset("flip").task_settings
    task, why = task_of(session, "reach")  # measures by its demonstrations
    assert task is None and "run the policy in its folder" in why
