# SPDX-License-Identifier: Apache-2.0
"""An action whose goals end in another callback, under both executors."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from conftest import Probe, lift
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor

from wam_power_interfaces.action import ExecutePolicy
from wam_power_interfaces.msg import RolloutEnd
from wam_power_ros.ros import interface
from wam_power_ros.ros.action_server import Action
from wam_power_ros.ros.outcomes import Answer, Code

SUCCEEDED, CANCELED = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED
ABORTED = GoalStatus.STATUS_ABORTED


class Moves:
    """A node whose goals end when the test says so: "no" is refused, "now" is done at once."""

    def __init__(self, probe: Probe, kind: type[Executor], cancels: bool) -> None:
        node = rclpy.create_node("mover", context=probe.context)
        self.begun: list[str] = []
        self.cancelled: list[str] = []
        self.action = Action(
            node,
            ExecutePolicy,
            interface.EXECUTE_POLICY,
            self._begin,
            self._cancel if cancels else None,
        )
        self._executor = kind(context=probe.context)
        self._executor.add_node(node)
        self._ended = False
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def _spin(self) -> None:
        while not self._ended:
            self._executor.spin_once(timeout_sec=0.05)
        self._executor.shutdown()

    def _begin(self, id: str, goal: ExecutePolicy.Goal) -> Answer | None:
        if goal.policy.text == "no":
            raise ValueError("'no' is no policy")
        if goal.policy.text == "now":
            return Answer(Code.DONE, "done at once")
        self.begun.append(id)
        return None

    def _cancel(self, id: str) -> None:
        self.cancelled.append(id)

    def _do(self, work: Callable[[], object]) -> None:
        """Let work be done in the thread of the node, as in another of its callbacks."""
        done = threading.Event()
        self._executor.create_task(lambda: (work(), done.set()))
        assert done.wait(10.0)

    def report(self, id: str, stage: str) -> None:
        """Report a stage."""
        self._do(lambda: self.action.report(id, stage))

    def finish(self, id: str, answer: Answer, **more: object) -> None:
        """End a goal."""
        self._do(lambda: self.action.finish(id, answer, **more))

    def close(self) -> None:
        """End the node."""
        self._ended = True
        self._thread.join()


@pytest.fixture(params=[SingleThreadedExecutor, EventsExecutor])
def moves(probe: Probe, request: pytest.FixtureRequest) -> Iterator[Moves]:
    moves = Moves(probe, request.param, cancels=True)
    yield moves
    moves.close()


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


def test_a_goal_that_is_refused_or_done_at_once_ends_at_once(probe: Probe, moves: Moves) -> None:
    for text, code, says, status in (
        ("no", Code.REFUSED, "'no' is no policy", ABORTED),
        ("now", Code.DONE, "done at once", SUCCEEDED),
    ):
        sent = probe.ask("execute", text)
        answer = probe.answer(sent)
        assert (answer.code, answer.text, sent.status) == (code, says, status)
        assert not moves.begun and not moves.action.under_way


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


def test_an_action_without_a_cancel_goes_on(probe: Probe) -> None:
    moves = Moves(probe, SingleThreadedExecutor, cancels=False)
    sent = probe.ask("execute", lift("a"))
    probe.until(lambda: moves.begun, "the begin")
    assert not probe.cancel(sent)
    moves.finish(moves.begun[0], Answer(Code.DONE))
    assert probe.answer(sent).success and sent.status == SUCCEEDED
    moves.close()
