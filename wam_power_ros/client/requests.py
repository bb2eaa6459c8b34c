# SPDX-License-Identifier: Apache-2.0
"""Requests over topics, see `ros.requests`, and the wait for their answers."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from std_msgs.msg import String

from wam_power_ros.client.link import TIMEOUT, Link
from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Answer, Code, ServiceError
from wam_power_ros.ros.requests import Request, read_answer

REPEAT_PERIOD = 1.0  # [s of wall time] after which a request without any answer is sent again
FIRST_TIMEOUT = 10.0  # [s of wall time] after which a request without any answer counts as lost


@dataclass
class Asked:
    """A request that was sent.

    Attributes:
        what: Topic and thing to do, for messages.
        answers: Answers received so far.
    """

    what: str
    answers: list[Answer] = field(default_factory=list)

    @property
    def answer(self) -> Answer | None:
        """The answer that ended the request; None before."""
        ended = self.answers and self.answers[-1].code is not Code.BEGUN
        return self.answers[-1] if ended else None


class Requests:
    """Requests to one node on one topic.

    Args:
        link: Link in whose namespace the node runs.
        topic: Topic of the requests.
        answers: Topic of the answers.
        kind: Type of the requests.
    """

    def __init__(self, link: Link, topic: str, answers: str, kind: type = String) -> None:
        self._link = link
        self._publisher = link.node.create_publisher(kind, topic, interface.REQUESTS)
        self._asked: dict[str, Asked] = {}
        link.listen(String, answers, self._on_answer, interface.ANSWERS)

    def _on_answer(self, message: String) -> None:
        id, answer = read_answer(message)
        if id in self._asked:
            self._asked[id].answers.append(answer)

    @property
    def settled(self) -> bool:
        """Whether every request that was sent has an answer."""
        return all(asked.answers for asked in self._asked.values())

    def begin(self, do: str, **about: str) -> Asked:
        """Send a request, and wait until it has begun, was refused or counts as lost.

        Raises:
            ServiceError: No node takes such requests.
        """
        request = Request(do, about)
        return self.send(request.message(), request.id, do)

    def send(self, message: object, id: str, do: str) -> Asked:
        """Send a request of another type, as `begin` does."""
        publisher, link = self._publisher, self._link
        topic = publisher.topic_name
        timeout = link.appear_timeout
        if not link.until(publisher.get_subscription_count, f"a subscriber of {topic}", timeout):
            raise ServiceError(f"{topic} did not appear in {timeout:.0f} s")
        self._asked = {key: each for key, each in self._asked.items() if each.answer is None}
        asked = self._asked[id] = Asked(f"{topic} {do}")
        end = time.monotonic() + FIRST_TIMEOUT
        while not asked.answers and time.monotonic() < end:
            publisher.publish(message)
            link.until(lambda: asked.answers, timeout=REPEAT_PERIOD)
        return asked

    def ask(self, do: str, timeout: float = TIMEOUT, **about: str) -> Answer:
        """Send a request and return the answer that ends it.

        Raises:
            ServiceError: It was refused, or not answered in `timeout` [s of wall time].
        """
        asked = self.begin(do, **about)
        self._link.until(lambda: asked.answer, f"the end of {asked.what}", timeout)
        return succeeded(asked)


def succeeded(asked: Asked) -> Answer:
    """Answer of a request that was done.

    Raises:
        ServiceError: It was refused or not answered.
    """
    if (answer := asked.answer) is None:
        raise ServiceError(f"{asked.what} was not answered")
    if not answer.success:
        raise ServiceError(f"{asked.what} refused: {answer.text}", answer)
    return answer
