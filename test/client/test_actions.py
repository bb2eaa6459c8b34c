# SPDX-License-Identifier: Apache-2.0
"""Goals of actions: their results, refusals, and the end of a goal that was lost."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator

import pytest
import rclpy
from conftest import Probe, Process, Processes

from wam_power_interfaces.action import ResetScene
from wam_power_interfaces.msg import Policy
from wam_power_ros.client import actions
from wam_power_ros.client.actions import Action, Goal
from wam_power_ros.client.link import Link
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError

SERVER = """
from rclpy.node import Node
from wam_power_interfaces.action import ResetScene
from wam_power_ros.ros import interface, node_runner
from wam_power_ros.ros.action_server import Action
from wam_power_ros.ros.outcomes import Answer, Code

def begin(id, goal):
    print("begun", goal.policy.id, flush=True)
    if goal.policy.id == "done":
        return Answer(Code.DONE, "here you are")
    if goal.policy.id == "busy":
        return Answer(Code.BUSY, "not now", "17", 0.5)

def make():
    node = Node("server")
    node.actions = [Action(node, ResetScene, "act", begin)]
    return node

raise SystemExit(node_runner.run(make))
"""
COMMAND = [sys.executable, "-c", SERVER]


@pytest.fixture(scope="module")
def server(shared_nodes: tuple[Probe, Processes]) -> Process:
    return shared_nodes[1].start(COMMAND)


@pytest.fixture
def link(shared_nodes: tuple[Probe, Processes]) -> Iterator[Link]:
    context = shared_nodes[0].context
    with Link(rclpy.create_node("client", context=context), appear_timeout=20.0) as link:
        yield link


def send(action: Action, id: str) -> Goal:
    return action.send(policy=Policy(id=id))


def test_a_goal_that_is_done_gives_its_result_and_a_refused_one_an_error_with_its_answer(
    link: Link, server: Process
) -> None:
    action = Action(link, ResetScene, "act")
    done = send(action, "done")
    assert done.done().outcome.text == "here you are"
    assert done.answer.code is Code.DONE and done.accepted and done.ended
    busy = send(action, "busy")
    with pytest.raises(ServiceError, match="/act: not now") as raised:
        busy.done()
    assert raised.value.answer == busy.answer == Answer(Code.BUSY, "not now", "17", 0.5)
    assert action.answered


def test_an_action_that_does_not_appear_is_named(
    link: Link, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not Action(link, ResetScene, "nowhere").offered
    monkeypatch.setattr(link, "appear_timeout", 0.2)
    with pytest.raises(ServiceError, match="/nowhere did not appear"):
        send(Action(link, ResetScene, "nowhere"), "done")


def test_a_goal_without_an_end_is_an_error_after_the_timeout_and_goes_on(
    link: Link, server: Process
) -> None:
    goal = send(Action(link, ResetScene, "act"), "long")
    with pytest.raises(ServiceError, match="/act: no answer"):
        goal.done(timeout=0.5)
    assert goal.accepted and not goal.ended


def test_a_goal_that_nobody_accepts_counts_as_lost(
    link: Link, server: Process, monkeypatch: pytest.MonkeyPatch
) -> None:
    action = Action(link, ResetScene, "act")
    send(action, "done").done()
    monkeypatch.setattr(actions, "ACCEPT_TIMEOUT", 0.5)
    server.send_signal(signal.SIGSTOP)
    try:
        goal = send(action, "late")
        assert goal.ended and not goal.accepted and goal.answer.code is Code.UNKNOWN
        assert action.answered
    finally:
        server.send_signal(signal.SIGCONT)
    assert link.until(lambda: goal.accepted, timeout=20.0)
    assert goal.answer.code is Code.UNKNOWN  # it stays so


def test_a_goal_whose_server_was_killed_and_restarted_ends_as_unknown_within_seconds(
    link: Link, server: Process, shared_nodes: tuple[Probe, Processes]
) -> None:
    _, processes = shared_nodes
    action = Action(link, ResetScene, "act")
    goal = send(action, "long")
    assert goal.accepted and not goal.ended
    assert processes.end(server, signal.SIGKILL) == -signal.SIGKILL
    assert not link.until(lambda: goal.ended, timeout=2.0 * actions.ASK_PERIOD)  # nobody knows
    again = processes.start(COMMAND)
    assert link.until(lambda: goal.ended, timeout=30.0), processes.output(again)
    assert goal.answer.code is Code.UNKNOWN and goal.result is None
    assert send(action, "done").done().outcome.text == "here you are"
