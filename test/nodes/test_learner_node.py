# SPDX-License-Identifier: Apache-2.0
"""The learner without an arm: what it refuses before it calls any service."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import ROOT
from toss_task import demonstrated_policy

from wam_power_ros.control.arm import Arm
from wam_power_ros.params.resources import share
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset

COBOT = Arm(
    share("urdf/cobot7.urdf").read_text(),
    [f"cobot_joint{i}" for i in range(1, 8)],
    "cobot_pan",
    guarded=(),
).identity()


@pytest.mark.requirement("S-59")
def test_a_learner_goes_on_with_no_session_of_another_arm(tmp_path: Path, domain_id: int) -> None:
    folder = tmp_path / "session"
    policy = replace(demonstrated_policy(), arm=COBOT)
    Session.begin(folder, preset("flip"), 0, [policy]).close()
    command = [sys.executable, "-m", "wam_power_ros.cli", "run", "learner", "--ros-args"]
    command += ["--params-file", str(ROOT / "config/learner.yaml"), "-p", f"session:={folder}"]
    ended = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert ended.returncode == 2
    assert f"policy {policy.id} belongs to another arm: cobot7" in ended.stderr
    assert "this arm is wam7" in ended.stderr
    Session.open(folder).close()  # nothing was written, no lock is held
