# SPDX-License-Identifier: Apache-2.0
"""`wam-power doctor` says what was measured, what was not, and which command comes next."""

from __future__ import annotations

from pathlib import Path

import pytest

from wam_power_ros.cli import doctor_command
from wam_power_ros.cli.launcher import Devices
from wam_power_ros.params import body_tracker_params

MEASURED = """# Measured by wam7 and its cameras on 2026-06-01, with wam_power_ros 0.1.0.
/**/torque_controller:
  ros__parameters:
    joint_zeros: [0.0, 0.03, 0.01, 0.0, 0.0, 0.0, 0.0]
    coulomb_friction: [2.0]
    torque_scales: [0.98]
    loop_delay: 0.006
/**/pancake_tracker:
  ros__parameters:
    world_to_base: [1.2, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
"""


@pytest.fixture
def lab(tmp_path: Path) -> str:
    file = tmp_path / "lab.yaml"
    file.write_text(MEASURED)
    return str(file)


def shown(capsys: pytest.CaptureFixture[str], devices: Devices) -> tuple[int, str]:
    status = doctor_command.doctor(devices)
    return status, capsys.readouterr().out


def test_an_arm_that_was_never_measured_is_sent_to_commission(
    capsys: pytest.CaptureFixture[str], lab: str
) -> None:
    status, text = shown(capsys, Devices(["openarm", "natnet_ros2"]))
    assert status == 1
    assert "Missing: frame, zeros, friction, loop delay, motors, tool. Next, with" in text
    assert "wam-power commission\n" in text
    status, text = shown(capsys, Devices(["openarm", "natnet_ros2", lab]))
    assert status == 0
    assert "Nothing is missing here" in text and "largest 1.7 degrees" in text


def test_low_limits_of_the_elbow_are_a_warning_that_names_what_a_flip_needs(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, text = shown(capsys, Devices(["geodude"]))
    assert "a flip needs about 1.5 m/s of the elbow" in text
    _, text = shown(capsys, Devices(["geodude", "full_speed"]))
    assert "a flip needs" not in text


def test_where_the_body_is_seen_is_said_or_the_package_that_is_missing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    devices = Devices(["openarm", "mocap4r2_vicon"])
    _, text = shown(capsys, devices)
    assert "cameras      ok    mocap4r2_msgs/msg/RigidBodies on rigid_bodies, in the frame" in text
    monkeypatch.setattr(body_tracker_params, "find_spec", lambda package: None)
    _, text = shown(capsys, devices)
    assert "WARN  mocap4r2_msgs/msg/RigidBodies needs the package mocap4r2_msgs: apt" in text
