# SPDX-License-Identifier: Apache-2.0
"""The learner without an arm: what it refuses before it calls any service."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import ROOT
from toss_task import demonstrated_policy

from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.policy import to_json
from wam_power_ros.params.resources import share
from wam_power_ros.practice.session import Session, read
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


def test_a_session_begins_with_a_policy_that_was_learnt_elsewhere(
    tmp_path: Path, domain_id: int
) -> None:
    policy = demonstrated_policy()
    (tmp_path / "policy.json").write_text(to_json(policy))
    bag, folder = min((ROOT / "bags").glob("demo_*")), tmp_path / "session"
    command = [sys.executable, "-m", "wam_power_ros.cli", "run", "learner", "--ros-args"]
    command += ["--params-file", str(ROOT / "config/learner.yaml"), "-p", f"session:={folder}"]
    command += ["-p", f"policy:={tmp_path / 'policy.json'}", "-p", f"demonstrations:=['{bag}']"]
    learner = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    end = time.monotonic() + 120.0
    while not Session.exists(folder) and learner.poll() is None and time.monotonic() < end:
        time.sleep(0.1)
    learner.send_signal(signal.SIGINT)
    said = learner.communicate(timeout=60)[0].decode()
    assert Session.exists(folder), said
    begun = read(folder)
    assert begun.header.candidates == ["carried-over"]
    assert begun.header.demonstrations == [str(bag)]
    (carried,) = begun.policies
    assert carried.attractors.tolist() == policy.attractors.tolist()
