# SPDX-License-Identifier: Apache-2.0
"""Replaying a bag: what the arm is given to follow, and the whole command on the stand-in."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from wam_power_ros.bags import layout, reader
from wam_power_ros.cli import main
from wam_power_ros.console.replay import with_possible_speed
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.replay_trajectory import EASE, movement
from wam_power_ros.params.resources import share
from wam_power_ros.ros.answers import Answer, Code

ROOT = Path(__file__).resolve().parents[2]
NAMES = [f"wam_j{number}" for number in range(1, 8)]
ARM = Arm(share("urdf/wam7.urdf").read_text(), NAMES)
REACH = min(share("bags").glob("reach_*"))
TICK = 2_000_000  # [ns]


def recording(noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Two seconds of a swing that is under way from the first sample to the last."""
    t = np.arange(1001) * 0.002
    q = np.sin(2.0 * t)[:, None] * np.linspace(0.1, 0.7, 7)
    q += noise * np.random.default_rng(0).standard_normal(q.shape)
    return 1_700_000_000_000_000_000 + TICK * np.arange(1001), q


@pytest.mark.parametrize("speed", [0.25, 0.5, 1.0, 2.0])
def test_a_replay_goes_from_rest_to_rest_through_what_was_recorded(speed: float) -> None:
    stamps_ns, q = recording()
    t, followed = movement(stamps_ns, q, speed)
    assert t[0] == 0.0
    assert t[-1] == pytest.approx(2.0 / speed + EASE)
    np.testing.assert_allclose(followed[[0, -1]], q[[0, -1]], atol=1e-4)
    spline = CubicSpline(t, followed)
    assert np.abs(spline(t[[0, -1]], 1)).max() < 0.02
    fine = spline(np.linspace(0.0, t[-1], 4000))
    away = np.abs(fine[:, None] - q[None]).max(axis=2).min(axis=1)
    assert away.max() < 2e-3
    middle = np.abs(t - 0.5 * t[-1]) < 0.25 * t[-1]  # where it has come to its speed
    recorded = CubicSpline((stamps_ns - stamps_ns[0]) * 1e-9, q)
    at = (t[middle] - 0.5 * EASE) * speed
    np.testing.assert_allclose(followed[middle], recorded(at), atol=1e-3)
    np.testing.assert_allclose(spline(t[middle], 1), speed * recorded(at, 1), atol=0.02 * speed)


def test_what_encoders_add_is_smoothed_away() -> None:
    accelerations = []
    for noise in (0.0, 2e-4):
        t, followed = movement(*recording(noise), 1.0)
        accelerations.append(CubicSpline(t, followed)(t[5:-5], 2))
    raw = np.abs(np.diff(recording(2e-4)[1], 2, axis=0)).max() / 0.002**2
    assert raw > 100.0
    assert np.abs(accelerations[1] - accelerations[0]).max() < 3.0


@pytest.mark.parametrize("speed", [0.0, -1.0, np.nan, np.inf])
def test_a_speed_that_is_none_is_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="speed"):
        movement(*recording(), speed)


def test_a_recording_with_a_hole_is_refused() -> None:
    stamps_ns, q = recording()
    kept = np.r_[0:400, 600:1001]
    with pytest.raises(ValueError, match=r"gap of 0\.4"):
        movement(stamps_ns[kept], q[kept], 1.0)


def replaying(*arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "wam_power_ros.cli", "replay", *map(str, arguments)]
    return subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


@pytest.mark.parametrize("speed", [0.5, 1.0])
def test_a_shipped_bag_is_replayed_and_its_error_told(tmp_path: Path, speed: float) -> None:
    process = replaying(REACH, "--speed", speed, "--folder", tmp_path)
    said = process.communicate(timeout=900.0)[0]
    assert process.returncode == 0, said
    worst = float(re.search(r"rms error ([\d.]+) rad in the worst joint", said)[1])
    tool = float(re.search(r"tool: rms ([\d.]+) mm", said)[1])
    assert worst < 0.05
    assert tool < 10.0
    assert said.count(" rad, at most ") == 7
    (made,) = (tmp_path / "bags").iterdir()
    assert f"recorded: {made}" in said
    _, wanted = reader.read_demonstration(REACH, NAMES)
    _, done = reader.read_demonstration(made, NAMES)
    np.testing.assert_allclose(done[-1], wanted[-1], atol=0.03)
    assert np.abs(done - wanted[0]).max(axis=1).min() < 0.03  # it was at the start


def test_too_fast_a_replay_is_refused_with_the_speed_that_is_possible() -> None:
    stamps_ns, q = reader.read_demonstration(REACH, NAMES)
    controller = Controller(ARM)
    controller.step(1, q[0], np.zeros(7))
    controller.hold()

    def begin(speed: float) -> None:
        t, followed = movement(stamps_ns, q, speed)
        controller.start_replay(SimpleNamespace(t=t, q=followed))

    with pytest.raises(ControllerError) as refusal:
        begin(8.0)
    answer = Answer(Code(refusal.value.refusal.value), "too fast", refusal.value.values)
    said = with_possible_speed(answer, 8.0)
    possible = float(re.search(r"possible at --speed ([\d.]+)", said)[1])
    assert 1.0 < possible < 8.0
    begin(0.95 * possible)
    assert controller.mode is Mode.REPLAY


def test_what_is_no_bag_is_refused_before_anything_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["replay", str(tmp_path / "none"), "--folder", str(tmp_path / "r")]) == 2
    assert "is not a bag" in capsys.readouterr().err
    assert main.main(["replay", str(REACH), "--speed", "0", "--folder", str(tmp_path / "r")]) == 2
    assert "speed 0.0 must be positive" in capsys.readouterr().err
    assert not (tmp_path / "r").exists()


def test_a_replay_that_is_stopped_leaves_the_arm_holding_and_its_bag_closed(
    tmp_path: Path,
) -> None:
    process = replaying(REACH, "--speed", 0.01, "--folder", tmp_path)
    for line in process.stdout:
        if line.startswith("Replaying"):
            break
    time.sleep(3.0)
    process.send_signal(signal.SIGINT)
    said = process.stdout.read()
    assert process.wait(600.0) == 130, said
    assert "Stopped: the arm holds." in said
    (made,) = (tmp_path / "bags").iterdir()
    assert not made.name.endswith(layout.UNFINISHED)
    _, q = reader.read_demonstration(made, NAMES)
    assert np.abs(q[-1] - q[-10]).max() < 1e-3  # it holds
