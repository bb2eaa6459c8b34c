# SPDX-License-Identifier: Apache-2.0
"""The robot object: the example of its page is run here (`py`, not `python`: only here)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from conftest import Probe
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from test_docs import blocks

from wam_power_interfaces.action import Replay
from wam_power_ros.client.link import Link
from wam_power_ros.client.robot import REST_TIMES, Robot, Stopped
from wam_power_ros.client.rollouts import Rollouts, RolloutSettings
from wam_power_ros.control.arm import Arm
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import share
from wam_power_ros.ros import interface
from wam_power_ros.ros.action_server import Action
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError


@pytest.mark.long
def test_the_example_teaches_replays_moves_and_executes_a_policy() -> None:
    before, example = dict(os.environ), dict[str, Any]()
    (block,) = blocks("docs/robot.md", "py")
    exec(compile(block, "docs/robot.md", "exec"), example)
    assert dict(os.environ) == before
    start, moved, taught = example["start"], example["moved"], example["demonstration"]
    np.testing.assert_allclose(moved.q, example["home"], atol=0.02)
    assert np.abs(moved.qd).max() < 0.05
    position, _ = example["wam"].arm.tool_pose(moved.q)
    np.testing.assert_array_equal(moved.position, position)
    assert np.linalg.norm(moved.position - start.position) > 0.02
    assert np.ptp(taught.position[:, 2]) > 0.1
    assert "rms" in example["tracking"]
    executed, policy = example["executed"], example["policy"]
    assert executed.rollout.fault is None and executed.rollout.tool.id == policy.id
    first = executed.rollout.tool.position[0]
    np.testing.assert_allclose(first, taught.position[0], atol=0.02)
    assert len(executed.rollout.body.t) > 10 and executed.bag.startswith("rollout")


def test_a_posture_beyond_the_limits_is_refused_before_anything_is_sent() -> None:
    names = [f"wam_j{i}" for i in range(1, 8)]
    never = Robot(None, arm=Arm(share("urdf/wam7.urdf").read_text(), names))
    for q in ([0.0] * 6, [0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0], [np.nan] * 7):
        with pytest.raises(ValueError, match="must be 7 angles within"):
            never.move_to(q)


@pytest.fixture
def asked(probe: Probe) -> Iterator[tuple[Robot, list[str], list[Answer]]]:
    """A robot, what its controller was asked, and the answers to replays that it still has."""
    said: list[str] = []
    answers: list[Answer] = []
    node = rclpy.create_node("controller", context=probe.context)

    def stop(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        said.append("stop")
        for id in [*replays.under_way]:
            replays.finish(id, Answer(Code.STOPPED, "stopped", "17", 0.0))
        response.success = True
        return response

    def replay(id: str, goal: Replay.Goal) -> Answer | None:
        said.append("replay")
        return answers.pop(0) if answers else None

    replays = Action(node, Replay, interface.REPLAY_MOVEMENT, replay)
    node.create_service(Trigger, interface.STOP, stop)
    client = rclpy.create_node("client", context=probe.context)
    with Link(node), Link(client) as link:
        yield Robot(link, joint_names=["a"]), said, answers


MOVEMENT = REST_TIMES, np.zeros((len(REST_TIMES), 1))


def test_an_interrupt_stops_the_arm_and_keeps_the_answer_of_the_controller(
    asked: tuple[Robot, list[str], list[Answer]], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, said, _ = asked
    until = robot.link.until

    def interrupted(condition: Callable[[], object], what: str = "", timeout: float = 60.0) -> bool:
        if what == f"the end of /{interface.REPLAY_MOVEMENT}" and said[-1] == "replay":
            raise KeyboardInterrupt
        return until(condition, what, timeout)

    monkeypatch.setattr(robot.link, "until", interrupted)
    with pytest.raises(Stopped) as raised:
        robot.follow(*MOVEMENT)
    assert isinstance(raised.value, KeyboardInterrupt)
    assert raised.value.answer == Answer(Code.STOPPED, "stopped", "17", 0.0)
    assert said == ["stop", "replay", "stop"]


def test_the_answer_to_a_replay_is_its_text_or_an_error_that_has_it(
    asked: tuple[Robot, list[str], list[Answer]],
) -> None:
    robot, said, answers = asked
    answers.append(Answer(Code.DONE, "rms error"))
    assert robot.follow(*MOVEMENT) == "rms error"
    refused = Answer(Code.REFUSED, "never", speed=0.0)
    answers.append(refused)
    with pytest.raises(ServiceError, match="never") as raised:
        robot.follow(*MOVEMENT)
    assert raised.value.answer == refused
    assert said == ["stop", "replay"] * 2


def names(node: Node) -> set[str]:
    """Topics and services of a node, without those of every node."""
    of = (node.get_name(), node.get_namespace())
    found = [
        *node.get_publisher_names_and_types_by_node(*of),
        *node.get_subscriber_names_and_types_by_node(*of),
        *node.get_client_names_and_types_by_node(*of),
    ]
    return {name for name, _ in found} - {"/rosout", "/parameter_events", interface.DIAGNOSTICS}


def test_a_robot_uses_the_names_of_its_namespace(domain_id: int) -> None:
    setup = overlay.setup()
    rclpy.init(domain_id=domain_id)
    try:
        node = rclpy.create_node("robot", namespace="left")
        link = Link(node)
        Rollouts(link, RolloutSettings(**setup["learner"]), "pancake")
        link.poll_latest(JointState, "joint_states")
        of_listener = node.get_subscriber_names_and_types_by_node("robot_states", "/left")
        listener = {name for name, _ in of_listener}
        used = names(node) | listener
        assert {"/left/controller/reset", "/left/joint_states"} <= used
        assert {name for name in used if not name.startswith("/left/")} == set()
    finally:
        rclpy.shutdown()
