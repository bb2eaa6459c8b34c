# SPDX-License-Identifier: Apache-2.0
"""Goals of actions, and the wait for their results."""

from __future__ import annotations

import time
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.task import Future

from wam_power_ros.client.link import DISCOVERY, TIMEOUT, Link
from wam_power_ros.ros import outcomes
from wam_power_ros.ros.outcomes import NO_ANSWER, Answer, ServiceError
from wam_power_ros.ros.stamps import goal_id

ACCEPT_TIMEOUT = 10.0  # [s of wall time] after which a goal that nobody accepts counts as lost
ASK_PERIOD = 2.0  # [s of wall time] between questions for a result: a new server knows no old goal


class Goal:
    """A goal that was sent; `answer` is its outcome, `result` its result, None before its end."""

    def __init__(self, link: Link, what: str, sent: Future) -> None:
        self._link, self.what, self._sent, self._asked_at = link, what, sent, time.monotonic()
        self.result: Any = None
        self.answer: Answer | None = None
        sent.add_done_callback(lambda _: self._ask())

    def _ask(self) -> None:
        self._asked_at = time.monotonic()
        self._sent.result().get_result_async().add_done_callback(self._ended)

    def _ended(self, asked: Future) -> None:
        if self.answer is None:
            response = asked.result()
            if response.status == GoalStatus.STATUS_UNKNOWN:  # the server was restarted
                self.answer = NO_ANSWER
            else:
                self.result, self.answer = response.result, outcomes.read(response.result.outcome)
        self._link.notify()

    @property
    def accepted(self) -> bool:
        """Whether a server has accepted it."""
        return bool(self._sent.done())

    @property
    def ended(self) -> bool:
        """Whether it has ended or is lost; to be asked again and again."""
        if self.answer is None:
            silent = time.monotonic() - self._asked_at
            if self.accepted and silent > ASK_PERIOD:
                self._asked_at = time.monotonic()
                self._link.schedule(self._ask)
            elif not self.accepted and silent > ACCEPT_TIMEOUT:
                self.answer = NO_ANSWER
        return self.answer is not None

    def done(self, timeout: float = TIMEOUT) -> Any:  # noqa: ANN401 - result of the action
        """Return the result, or raise a ServiceError if refused or not ended in `timeout` [s]."""
        self._link.until(lambda: self.ended, f"the end of {self.what}", timeout)
        answer = self.answer or NO_ANSWER
        if not answer.success:
            raise ServiceError(f"{self.what}: {answer.message}", answer)
        return self.result


class Action:
    """Client of one action."""

    def __init__(self, link: Link, kind: Any, name: str) -> None:  # noqa: ANN401 - any action
        self._link, self._kind = link, kind
        self._name = link.node.resolve_topic_name(name)
        self._client = ActionClient(link.node, kind, name)
        self._goals: list[Goal] = []

    @property
    def offered(self) -> bool:
        """Whether a server is there and has had the time to discover this client."""
        return self._link.discovered(self._name, self._client.server_is_ready)

    @property
    def answered(self) -> bool:
        """Whether every goal that was sent has been accepted or is lost."""
        return all(goal.accepted or goal.ended for goal in self._goals)

    def send(self, **goal: object) -> Goal:
        """Send a goal, wait until it is accepted or lost; a ServiceError if no server appears."""
        link, name = self._link, self._name
        link.await_server("action", name, self._client.server_is_ready)
        self._goals = [each for each in self._goals if each.answer is None]
        request = self._kind.Goal(**goal)
        send = lambda: self._client.send_goal_async(request, goal_uuid=goal_id())  # noqa: E731
        sending = link.schedule(lambda: Goal(link, name, send()))
        link.until(sending.done)
        sent = sending.result()
        self._goals.append(sent)
        link.until(lambda: sent.accepted or sent.ended, timeout=ACCEPT_TIMEOUT + DISCOVERY)
        return sent
