# SPDX-License-Identifier: Apache-2.0
"""The command `replay`: refused, stopped by Ctrl-C, ended with a node."""

from __future__ import annotations

import _thread
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bag_samples import REACH, WAM
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from wam_power_interfaces.action import Replay
from wam_power_ros.bags import reader
from wam_power_ros.cli.launcher import Devices, Launcher
from wam_power_ros.cli.plan import DOMAIN_FILE, Plan
from wam_power_ros.cli.processes import ProcessError, Processes
from wam_power_ros.client.robot import Robot
from wam_power_ros.console import replay_running
from wam_power_ros.console.replay import replay, with_possible_speed
from wam_power_ros.control import replay_trajectory
from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.ros import interface
from wam_power_ros.ros.action_server import Action
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError, fill


def test_without_nodes_a_replay_on_them_says_what_to_do(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay_running, "APPEAR_TIMEOUT", 0.5)
    with pytest.raises(ServiceError, match="no node torque_controller in this domain"):
        replay_running.replay_running(robot.link, REACH, 1.0)


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
    ("code", "kept", "says"),
    [
        (Code.TOO_FAST, False, "no; possible at --speed 0.50\n"),
        (Code.FAULT, True, "recorded: "),
        (Code.STOPPED, True, "Stopped: the arm holds."),
    ],
)
def test_a_replay_leaves_a_bag_if_the_arm_has_moved(
    server: Node,
    robot: Robot,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    code: Code,
    kept: bool,
    says: str,
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
    assert made.exists() == kept and says in said
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


def test_a_node_that_ends_ends_a_wait_for_the_arm_with_its_name_at_once(
    domain_id: int, tmp_path: Path
) -> None:
    plan = Plan(tmp_path, Devices().parameters(), stand_ins=True)
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / DOMAIN_FILE).write_text(str(domain_id))
    with Processes(tmp_path, {}) as processes, Launcher(plan, processes).robot() as robot:
        node = processes.start("torque_controller", ["sleep", "60"])
        with pytest.raises(ProcessError, match="torque_controller was ended by SIGKILL"):
            node.process.kill()
            robot.link.until(lambda: False, timeout=60.0)
