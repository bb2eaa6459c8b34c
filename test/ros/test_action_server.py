# SPDX-License-Identifier: Apache-2.0
"""An action whose goals end in another callback."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from conftest import Probe, lift

from wam_power_interfaces.action import ExecutePolicy
from wam_power_interfaces.msg import RolloutEnd
from wam_power_ros.client.link import Link
from wam_power_ros.ros import interface
from wam_power_ros.ros.action_server import Action
from wam_power_ros.ros.outcomes import Answer, Code

SUCCEEDED, CANCELED = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED


class Moves:
    """A node whose goals end when the test says so."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self.begun: list[str] = []
        self.cancelled: list[str] = []
        of = ExecutePolicy, interface.EXECUTE_POLICY, self._begin, self.cancelled.append
        self.action = Action(link.node, *of)

    def _begin(self, id: str, _: ExecutePolicy.Goal) -> None:
        self.begun.append(id)

    def report(self, id: str, stage: str) -> None:
        """Report a stage, as in another callback of the node."""
        self._link.until(self._link.schedule(lambda: self.action.report(id, stage)).done)

    def finish(self, id: str, answer: Answer, **more: object) -> None:
        """End a goal, as in another callback of the node."""
        self._link.until(self._link.schedule(lambda: self.action.finish(id, answer, **more)).done)


@pytest.fixture
def link(probe: Probe) -> Iterator[Link]:
    with Link(rclpy.create_node("mover", context=probe.context)) as link:
        yield link


@pytest.fixture
def moves(link: Link) -> Moves:
    return Moves(link)


def test_a_goal_reports_its_stage_and_ends_with_its_outcome_and_result_when_it_is_finished(
    probe: Probe, moves: Moves
) -> None:
    sent = probe.ask("execute", lift("a"))
    probe.until(lambda: moves.begun, "the begin")
    assert list(moves.action.under_way) == moves.begun
    moves.report(moves.begun[0], "moving")
    probe.until(lambda: sent.stages, "its stage")
    probe.spin(0.2)
    assert sent.stages == ["moving"] and sent.result is None
    end = RolloutEnd(policy_id="a", region="the obstacle")
    moves.finish(moves.begun[0], Answer(Code.DONE, "done"), end=end)
    answer = probe.answer(sent)
    assert (answer.code, answer.text, sent.status) == (Code.DONE, "done", SUCCEEDED)
    assert sent.result.end == end
    assert not moves.action.under_way


def test_a_goal_that_is_cancelled_ends_once_when_what_it_asked_for_has_ended(
    probe: Probe, moves: Moves
) -> None:
    for count, (code, status) in enumerate(
        ((Code.STOPPED, CANCELED), (Code.DONE, SUCCEEDED), (Code.FAULT, CANCELED)), start=1
    ):
        sent = probe.ask("execute", lift("a"))
        probe.until(lambda: len(moves.begun) == count, "the begin")  # noqa: B023
        assert probe.cancel(sent)
        assert moves.cancelled == moves.begun and sent.result is None
        moves.finish("another", Answer(Code.DONE))
        moves.finish(moves.begun[-1], Answer(code, stop="17"))
        moves.finish(moves.begun[-1], Answer(Code.BUSY))
        answer = probe.answer(sent)
        assert (answer.code, answer.stop, sent.status) == (code, "17", status)
