# SPDX-License-Identifier: Apache-2.0
"""`wam-power commission` on a recording that exists: what is printed, written and refused."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import true_arm
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message

from wam_power_ros import rotations
from wam_power_ros.bags import layout
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.commands import ARRAY, TRAJECTORY, read_commands
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.cli import commission_command, main
from wam_power_ros.commissioning.measurement import Recording
from wam_power_ros.control.servo_response import followed
from wam_power_ros.params import overlay
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.ros.joint_messages import JointStateWriter, TorqueWriter
from wam_power_ros.ros.stamps import time_message

START = 1_700_000_000_000_000_000
COMMANDS = "/effort_controller/commands"
ARM = true_arm.plain()
QOS = [layout.qos(reliable=True, latched=False)]


def bag_of(path: Path, recorded: Recording, kind: str = "multiarray") -> Path:
    """Bag of a recording, as our recorder writes it."""
    write_state, write = JointStateWriter(true_arm.JOINTS), TorqueWriter(true_arm.JOINTS, kind)
    command = {"multiarray": ARRAY, "trajectory": TRAJECTORY}[kind]
    writer = BagWriter(path)
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    writer.add(COMMANDS, command, QOS)
    writer.add("/pancake/state", "nav_msgs/msg/Odometry", QOS)
    for t, q, tau in zip(recorded.t, recorded.q, recorded.tau, strict=True):
        stamp = START + round(1e9 * t)
        writer.write("/joint_states", stamp, serialize_message(write_state(stamp, q, (), ())))
        writer.write(COMMANDS, stamp, serialize_message(write(stamp, "replay", tau)))
    quats = rotations.quat_xyzw(recorded.rotation)
    for t, position, quat in zip(recorded.seen_t, recorded.position, quats, strict=True):
        message, stamp = Odometry(), START + round(1e9 * t)
        message.header.stamp = time_message(stamp)
        p, o = message.pose.pose.position, message.pose.pose.orientation
        p.x, p.y, p.z = position.tolist()
        o.x, o.y, o.z, o.w = quat.tolist()
        writer.write("/pancake/state", stamp, serialize_message(message))
    return writer.close({"joint_names": json.dumps(true_arm.JOINTS)})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the movement and a bag, of which `recorded` is what is read."""
    made = tmp_path_factory.mktemp("commissioning")
    plan = true_arm.planned()
    np.savez(made / "movement.npz", t=plan.t, q=plan.q, rests=plan.rests, sweeps=plan.sweeps)
    (made / "bags/commissioning_1").mkdir(parents=True)
    return made


@functools.cache
def recorded() -> Recording:
    return true_arm.recording(true_arm.planned(), true_arm.truth())


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["wam-power", "commission", *words])
    return main.main()


def test_the_file_that_is_written_corrects_the_arm_and_keeps_an_older_one(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = folder / "lab.yaml"
    file.write_text("# by hand\n")
    monkeypatch.setattr(commission_command, "_recording", lambda *_: recorded())
    assert run(monkeypatch, "--folder", str(folder), "--output", str(file)) == 0
    shown = capsys.readouterr().out
    assert f"--config {file}" in shown
    assert "existed: kept as" in shown
    (kept,) = folder.glob("lab.yaml.*")
    assert kept.read_text() == "# by hand\n"
    noted = r"note: zero of wam_j6: -[23]\.?\d* degrees \(allowed: -2 to 2\); better zero the arm"
    assert re.search(f"^{noted}", shown, re.MULTILINE)
    assert re.search(f"^# {noted}", file.read_text(), re.MULTILINE)
    assert "sweeps" in shown
    for word in ("cameras", "zeros", "friction", "motors", "payload", "not explained"):
        assert word in shown
    setup = overlay.setup([str(file)], simulated=True)
    params = TorqueControllerParams.from_setup(setup)
    assert np.allclose(params.joint_zeros, true_arm.ZEROS, atol=np.deg2rad(0.3))
    assert 0.0 < params.teaching_friction <= 0.8
    position = np.array(setup["pancake_tracker"]["world_to_base"][:3])
    assert np.allclose(position, true_arm.CAMERAS.inverse().position, atol=3e-3)
    assert setup["pancake_tracker"]["latency_offset"] == pytest.approx(0.003, abs=1e-3)
    truth = true_arm.plain().corrected(true_arm.truth())
    q = true_arm.HOME + 0.2
    assert np.linalg.norm(setup.arm().tool_pose(q)[0] - truth.tool_pose(q)[0]) < 5e-3


def test_a_recording_is_what_a_bag_has_of_states_torques_and_cameras(tmp_path: Path) -> None:
    rng, count, frames = np.random.default_rng(0), 80, 16
    given = Recording(
        t=0.002 * np.arange(count),
        q=rng.uniform(-0.01, 0.01, (count, 7)),
        tau=rng.normal(0.0, 5.0, (count, 7)),
        seen_t=0.01 * np.arange(frames),
        position=rng.normal(0.0, 1.0, (frames, 3)),
        rotation=rotations.exp(rng.normal(0.0, 0.5, (frames, 3))),
    )
    read = commission_command._recording(bag_of(tmp_path / "bag", given), overlay.setup([]))
    for name in ("t", "q", "tau", "seen_t", "position", "rotation"):
        wanted, found = getattr(given, name), getattr(read, name)
        np.testing.assert_allclose(found - found[0], wanted - wanted[0], atol=1e-6, err_msg=name)
    assert read.seen_t[0] - read.t[0] == pytest.approx(0.0, abs=1e-6)


def test_nothing_is_written_of_what_is_not_usable(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "movement.npz").write_bytes((folder / "movement.npz").read_bytes())
    (tmp_path / "bags").symlink_to(folder / "bags")
    for name in ("_recording", "analyse", "report", "notes"):
        monkeypatch.setattr(commission_command, name, lambda *_: [])
    monkeypatch.setattr(commission_command, "refusals", lambda *_: ["zero of wam_j4: 7 degrees"])
    assert run(monkeypatch, "--folder", str(tmp_path)) == 1
    shown = capsys.readouterr().out
    assert shown == "not usable: zero of wam_j4: 7 degrees\nNothing was written.\n"
    assert not (tmp_path / "arm.yaml").exists()


def test_a_movement_that_was_stopped_is_planned_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*given: object) -> int:
        (tmp_path / "movement.npz").touch()
        (tmp_path / "bags/commissioning_1").mkdir(parents=True)
        return 130

    monkeypatch.setattr(commission_command, "_move", stopped)
    assert run(monkeypatch, "--folder", str(tmp_path)) == 130
    assert not (tmp_path / "movement.npz").exists() and not (tmp_path / "arm.yaml").exists()


def test_where_the_driver_adds_gravity_what_it_adds_is_counted(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    extra = tmp_path / "adds.yaml"
    extra.write_text(
        "/**/torque_controller:\n  ros__parameters:\n    driver_compensates_gravity: true\n"
    )
    true, found = true_arm.truth(), recorded()
    gravity = np.array([ARM.gravity(q) for q in found.q])  # it knows neither zeros nor tool
    (tmp_path / "movement.npz").write_bytes((folder / "movement.npz").read_bytes())
    (tmp_path / "bags/commissioning_1").mkdir(parents=True)
    without = replace(found, tau=found.tau - gravity)
    monkeypatch.setattr(commission_command, "_recording", lambda *_: without)
    words = ["--folder", str(tmp_path), "--config", str(extra), "--simulate"]
    assert run(monkeypatch, *words) == 0
    assert "is taken for that of the URDF" in capsys.readouterr().out
    params = TorqueControllerParams.from_setup(
        overlay.setup([str(extra), str(tmp_path / "arm.yaml")], simulated=True)
    )
    assert np.allclose(params.coulomb_friction[:6], true.coulomb_friction[:6], rtol=0.1)
    assert np.allclose(params.base_tilt, true.base_tilt, atol=np.deg2rad(0.3))
    assert params.payload[0] == pytest.approx(0.08, abs=0.06)


@pytest.mark.parametrize(
    ("ask", "reason"),
    [
        (lambda bag, s: read_commands(bag, "/other", s, true_arm.JOINTS), "no topic /other"),
        (lambda bag, s: read_commands(bag, "/pancake/state", s, true_arm.JOINTS), "of type"),
        (lambda bag, s: read_commands(bag, COMMANDS, s, true_arm.JOINTS[:6]), "7 values"),
        (lambda bag, s: read_commands(bag, COMMANDS, s + 1, true_arm.JOINTS), "were answered"),
    ],
)
def test_torques_that_cannot_be_read_are_named(
    tmp_path: Path, ask: Callable[[Bag, np.ndarray], object], reason: str
) -> None:
    t = 1.0 + 0.002 * np.arange(20)
    zero, nothing = np.zeros((20, 7)), np.empty((0, 3))
    given = Recording(t, zero, zero, np.empty(0), nothing, np.empty((0, 3, 3)))
    bag = Bag(bag_of(tmp_path / "bag", given))
    with pytest.raises(ValueError, match=reason):
        ask(bag, START + np.round(1e9 * t).astype(np.int64))


def servo_recorded(folder: Path, lag: float) -> list[str]:
    """Words of a command that analyses a movement of an arm that takes positions."""
    t = np.arange(0.0, 4.0, 0.002)
    q = np.outer(np.sin(3.0 * t) ** 3, 0.1 * np.arange(7))
    empty = np.empty((0, 3)), np.empty((0, 3, 3))
    recorded = Recording(t, followed(q, 0.002, 0.03, lag), q, np.empty(0), *empty)
    (folder / "bags").mkdir()
    none = np.empty((0, 2))
    np.savez(folder / "movement.npz", t=t, q=q, rests=none, sweeps=none)
    bag_of(folder / "bags/commissioning_1", recorded, "trajectory")
    values = {"output": "trajectory", "command_topic": "effort_controller/commands"}
    text = json.dumps({"torque_controller": {"ros__parameters": values}})
    (folder / "lab.yaml").write_text(text)
    return ["commission", "--folder", str(folder), "--config", str(folder / "lab.yaml")]


def test_an_arm_that_takes_positions_measures_how_late_it_follows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = servo_recorded(tmp_path, 0.02)
    assert main.main(words) == 0
    assert "30 ms of delay and 20 ms of lag" in capsys.readouterr().out
    setup = overlay.setup([str(tmp_path / "lab.yaml"), str(tmp_path / "arm.yaml")])
    settings = TorqueControllerParams.from_setup(setup).controller(true_arm.URDF).settings
    assert (settings.servo_delay, settings.servo_lag) == (0.03, 0.02)


def test_a_servo_that_is_none_is_not_written_and_poses_are_not_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(servo_recorded(tmp_path, 1.0)) == 1
    assert "Nothing was written" in capsys.readouterr().out
    assert not (tmp_path / "arm.yaml").exists()
    assert main.main(["commission", "--folder", str(tmp_path / "none"), "--config", "pose"]) != 0
    assert "output = pose" in capsys.readouterr().err
