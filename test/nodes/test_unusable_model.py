# SPDX-License-Identifier: Apache-2.0
"""Over DDS: a model that cannot carry the arm is refused before a torque is sent."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Probe, Processes, diagnosis
from played_arm import HOME, NAMES, PlayedArm
from sensor_msgs.msg import JointState

from wam_power_ros.ros import interface

URDF = (ROOT / "urdf/wam7.urdf").read_text()


@pytest.fixture
def massless(tmp_path: Path) -> Path:
    """A URDF in which the last two links and the pan have no mass."""
    links = re.split("(?=<link name=)", URDF)
    bare = re.compile('<link name="(wam_link[67]|pan)"')
    kept = [
        re.sub("<inertial>.*?</inertial>", "", link, flags=re.DOTALL) if bare.match(link) else link
        for link in links
    ]
    (file := tmp_path / "massless.urdf").write_text("".join(kept))
    return file


@pytest.mark.requirement("S-111")
def test_the_controller_of_an_arm_without_masses_names_the_links_and_sends_nothing(
    probe: Probe, processes: Processes, massless: Path
) -> None:
    arm = PlayedArm(probe, processes, urdf=str(massless))

    def refused() -> bool:
        arm.send()
        probe.spin(0.02)
        report = diagnosis(arm.diagnostics, "torque_controller")
        return "move without mass" in report.get("last refusal", "")

    probe.until(refused, "the refusal is reported")
    report = diagnosis(arm.diagnostics, "torque_controller")
    links = ["wam_link6", "wam_link7", "wam_tool_plate", "pan"]
    assert f"links {links} move without mass" in report["last refusal"]
    assert not arm.read()
    assert arm.process.poll() is None


@pytest.mark.requirement("S-111")
def test_check_driver_names_the_links_that_move_without_mass(
    probe: Probe, processes: Processes, massless: Path, tmp_path: Path
) -> None:
    setup = tmp_path / "my_arm.yaml"
    setup.write_text(f"torque_controller:\n  ros__parameters:\n    urdf: {massless}\n")
    check = [sys.executable, "-m", "wam_power_ros.cli", "run", "check_driver"]
    process = processes.start([*check, "--config", str(setup), "--seconds", "1"])
    states = probe.publisher(JointState, interface.JOINT_STATES, interface.STATE_OUT)
    message = JointState(name=NAMES, position=list(HOME), velocity=list(np.zeros(7)))

    def ended() -> bool:
        message.header.stamp = probe.node.get_clock().now().to_msg()
        states.publish(message)
        probe.spin(0.002)
        return process.poll() is not None

    probe.until(ended, "the check ends")
    assert process.returncode == 2
    text = " ".join(processes.output(process).split())
    assert "'wam_link6', 'wam_link7', 'wam_tool_plate', 'pan'] move without mass" in text
