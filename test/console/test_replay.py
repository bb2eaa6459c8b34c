# SPDX-License-Identifier: Apache-2.0
"""The command `replay`: finished on the stand-in, refused, stopped by Ctrl-C."""

from __future__ import annotations

import _thread
import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_samples import REACH, WAM
from conftest import ROOT, Probe, Processes
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from wam_power_interfaces.action import Replay
from wam_power_ros.bags import reader
from wam_power_ros.client.robot import Robot
from wam_power_ros.console.replay import replay, with_possible_speed
from wam_power_ros.control import replay_trajectory
from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.ros import interface
from wam_power_ros.ros.action_server import Action
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError, fill


def replaying(*arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "wam_power_ros.cli", "replay", *map(str, arguments)]
    return subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def test_a_shipped_bag_is_replayed_and_its_tracking_error_reported(tmp_path: Path) -> None:
    process = replaying(REACH, "--speed", 1.5, "--folder", tmp_path)
    said = process.communicate(timeout=900.0)[0]
    assert process.returncode == 0, said
    worst = float(re.search(r"rms error ([\d.]+) rad in the worst joint", said)[1])
    tool = float(re.search(r"tool: rms ([\d.]+) mm", said)[1])
    assert worst < 0.05
    assert tool < 10.0
    assert said.count(" rad, at most ") == 7
    (made,) = (tmp_path / "bags").iterdir()
    assert f"recorded: {made}" in said
    _, wanted = reader.read_demonstration(REACH, WAM)
    _, done = reader.read_demonstration(made, WAM)
    np.testing.assert_allclose(done[-1], wanted[-1], atol=0.03)
    assert np.abs(done - wanted[0]).max(axis=1).min() < 0.03  # at the start


def test_without_nodes_a_replay_on_them_says_what_to_do(processes: Processes, probe: Probe) -> None:
    code = """
from wam_power_ros.console import replay_running
replay_running.APPEAR_TIMEOUT = 1.0
raise SystemExit(replay_running.main())
"""
    process = processes.start([sys.executable, "-c", code, str(REACH)])
    assert process.wait(60.0) == 2
    assert "no node torque_controller in this domain" in processes.output(process)


def test_the_possible_speed_is_given_as_a_value_of_the_option() -> None:
    too_fast = Answer(Code.TOO_FAST, "refused", speed=0.4)
    assert with_possible_speed(too_fast, 2.0) == "refused; possible at --speed 0.80"
    assert with_possible_speed(Answer(Code.STOPPED, "stopped"), 2.0) == "stopped"
    jump = Answer(Code.TOO_FAST, "refused", speed=0.001)
    assert with_possible_speed(jump, 2.0) == "refused; no --speed is slow enough"


def test_an_invalid_bag_or_speed_is_refused_before_any_node_starts(
    refusal: Callable[..., str],
) -> None:
    assert "is not a bag" in refusal("replay", "none", "--folder", "r")
    said = refusal("replay", str(REACH), "--speed", "9", "--folder", "r")
    assert "speed 9.0 of a replay must be from 0.01 to 5" in said


@pytest.mark.parametrize(
    ("code", "kept"),
    [(Code.TOO_FAST, False), (Code.FAULT, True), (Code.STOPPED, True)],
)
def test_a_replay_leaves_a_bag_if_the_arm_has_moved(
    server: Node,
    robot: Robot,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    code: Code,
    kept: bool,
) -> None:
    made, asked = tmp_path / "replay_1", []

    def answer(text: str) -> Callable[..., Any]:
        def respond(_: object, response: Trigger.Response) -> Trigger.Response:
            made.mkdir(exist_ok=True)
            asked.append(text)
            response.success, response.message = True, text
            return response

        return respond

    def end(id: str, goal: Replay.Goal) -> Answer:
        if code is Code.STOPPED:
            _thread.interrupt_main()  # as Ctrl-C does, without what rclpy adds to it
        return Answer(code, "no", speed=0.5 if code is Code.TOO_FAST else math.nan)

    Action(server, Replay, interface.REPLAY_MOVEMENT, end)
    server.create_service(Trigger, interface.STOP, answer("stop"))
    server.create_service(SetBool, interface.RECORD, answer(str(made)))
    robot.joint_names = WAM
    movement = replay_trajectory.movement(*reader.read_demonstration(REACH, WAM), 1.0)
    stopped = code is Code.STOPPED
    status = replay(robot, "reach", *movement, 1.0, person=False)
    said = capsys.readouterr().out
    assert status == (INTERRUPTED if stopped else 1)
    assert made.exists() == kept
    assert ("nothing was recorded" in said) != kept
    assert ("Stopped: the arm holds." in said) == stopped
    record = str(made)  # begun, and ended after the stop
    assert asked == ["stop", record, "stop", *(["stop"] if stopped else []), record]


@pytest.mark.parametrize("still_active", [True, False])
def test_only_a_controller_that_is_still_starting_is_asked_again(
    server: Node, robot: Robot, still_active: bool
) -> None:
    """One that was deactivated meanwhile does not move the arm once it is activated again."""
    answers = [Answer(Code.NOT_ACTIVE, "not active"), Answer(Code.DONE, "followed")]
    stops = [Answer(Code.DONE), Answer(Code.DONE if still_active else Code.NOT_ACTIVE)]
    Action(server, Replay, interface.REPLAY_MOVEMENT, lambda id, goal: answers.pop(0))
    server.create_service(Trigger, interface.STOP, lambda _, sent: fill(sent, stops.pop(0)))
    robot.joint_names = WAM
    t, q = replay_trajectory.movement(*reader.read_demonstration(REACH, WAM), 1.0)
    if still_active:
        assert robot.follow(t, q) == "followed"
    else:
        with pytest.raises(ServiceError, match="not active"):
            robot.follow(t, q)
        assert len(answers) == 1


def test_a_node_that_ends_ends_a_replay_with_its_name_at_once(tmp_path: Path) -> None:
    process = replaying(REACH, "--speed", 0.01, "--folder", tmp_path)
    for line in process.stdout:
        if line.startswith("Replaying"):
            break
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    (controller,) = (
        int(child)
        for child in children
        if b"torque_controller" in Path(f"/proc/{child}/cmdline").read_bytes()
    )
    os.kill(controller, signal.SIGKILL)
    said = process.stdout.read()
    assert process.wait(600.0) == 2, said
    assert "wam-power: torque_controller was ended by SIGKILL" in said
    assert "did not answer" not in said and "Traceback" not in said
