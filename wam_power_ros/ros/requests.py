# SPDX-License-Identifier: Apache-2.0
"""Requests that bring what they are about, and answers that say which request they answer.

A service and a topic are not ordered: a request that refers to "the last policy" may overtake it.
So a request is one message with an id of its own, and whatever it is about is in it: the policy to
execute, the bag to add. Its answers, on another topic, carry that id. The first may say that it has
BEGUN; exactly one other ends it. A request that is received again, because its first answer was not
heard, is answered as before and not done again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from uuid import uuid4

from rclpy.node import Node
from std_msgs.msg import String

from wam_power_ros import plain_json
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Answer, Code

KEPT = 16  # last requests whose answers are kept
SIZE_MAX = 2 * plain_json.SIZE_MAX + 1000  # of a request about the largest policy, quoted [byte]
ID_MAX = 100  # characters


@dataclass(frozen=True)
class Request:
    """A request to a node.

    Attributes:
        do: Name of what is to be done, such as "execute".
        about: Texts by name, such as the policy to execute.
        id: Id of this request, by default one that no other request has.
    """

    do: str
    about: Mapping[str, str] = field(default_factory=dict)
    id: str = field(default_factory=lambda: uuid4().hex)

    def message(self) -> String:
        """Message of the request: a JSON object."""
        return String(data=json.dumps({"id": self.id, "do": self.do, **self.about}))


def request(text: str) -> Request:
    """Read the text of a request.

    Raises:
        ValueError: When it is not a JSON object of texts with `id` and `do`.
    """
    values = plain_json.parse(text, "a request", SIZE_MAX)
    if not isinstance(values, dict) or not all(isinstance(each, str) for each in values.values()):
        raise ValueError(f"a request must be a JSON object of texts, not {text[:100]!r}")
    if missing := {"id", "do"} - values.keys():
        raise ValueError(f"a request must have {sorted(missing)}")
    return Request(values.pop("do"), id=checked_id(values.pop("id")), about=values)


def checked_id(text: str) -> str:
    """Return the id of a request.

    Raises:
        ValueError: When it is empty or too long.
    """
    if not 0 < len(text) <= ID_MAX:
        raise ValueError(f"the id {text[:100]!r} of a request must have 1 to {ID_MAX} characters")
    return text


def answer_message(id: str, answer: Answer) -> String:
    """Message of an answer: a JSON object."""
    values = {"id": id, "code": answer.code.value, "text": answer.text, **answer.values}
    return String(data=json.dumps(values))


def read_answer(message: String) -> tuple[str, Answer]:
    """Id of the request and its answer in a message.

    Raises:
        ValueError: When it is not a JSON object with `id`, `code` and `text`.
    """
    values = plain_json.parse(message.data, "an answer")
    try:
        id, code, text = (values.pop(name) for name in ("id", "code", "text"))
        return str(id), Answer(Code(code), str(text), values)
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"{message.data[:200]!r} must be an answer: {error!r}") from error


@dataclass(frozen=True)
class RolloutEnd:
    """What the answer at the end of a rollout says.

    Attributes:
        id: Id of the policy.
        start_ns: Stamp of the start [ns], which the paths have as theirs.
        fault: Fault latched at the end, None without one.
        stopped_in: Name of the guarded region that ended it, "" if none did.
        stop: Id of the stop by which a person ended it, "" if none did.
    """

    id: str
    start_ns: int
    fault: Fault | None
    stopped_in: str = ""
    stop: str = ""

    def answer(self) -> Answer:
        """Answer that says this."""
        kind, text = (self.fault.kind.value, self.fault.text) if self.fault else ("", "")
        values = {"policy": self.id, "start_ns": str(self.start_ns), "fault": kind}
        values |= {"stopped_in": self.stopped_in, "stop": self.stop}
        return Answer(Code.DONE, text, values)

    @classmethod
    def of(cls, answer: Answer) -> RolloutEnd:
        """Read an answer.

        Raises:
            ValueError: When it is not about the end of a rollout.
        """
        values = answer.values
        try:
            fault = Fault(FaultKind(values["fault"]), answer.text) if values["fault"] else None
            ended = values["stopped_in"], values.get("stop", "")  # not in older bags
            return cls(values["policy"], int(values["start_ns"]), fault, *ended)
        except (KeyError, TypeError) as error:
            raise ValueError(f"{answer} is not about the end of a rollout: {error!r}") from error


class Answers:
    """Answers to requests, as the node gives them.

    Args:
        node: Node that answers.
        topic: Topic of the answers.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self._publisher = node.create_publisher(String, topic, interface.ANSWERS)
        self._known: dict[str, Answer | None] = {}

    def is_new(self, id: str) -> bool:
        """Whether a request is new; one that is known is answered as before."""
        if id not in self._known:
            self._keep(id, None)
            return True
        if (answer := self._known[id]) is not None:
            self._publisher.publish(answer_message(id, answer))
        return False

    def give(self, id: str, answer: Answer) -> None:
        """Answer a request."""
        self._keep(id, answer)
        self._publisher.publish(answer_message(id, answer))

    def _keep(self, id: str, answer: Answer | None) -> None:
        self._known.pop(id, None)
        self._known[id] = answer
        if len(self._known) > KEPT:
            del self._known[next(iter(self._known))]


class Server:
    """Takes the requests of a topic, one after another.

    Args:
        node: Node that offers them.
        topic: Topic of the requests.
        answers: Topic of the answers.
        begin: For each thing to do, the function that is called with a request. It returns the
            answer, or None if `finish` will be called. A ValueError that it raises refuses.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        answers: str,
        begin: Mapping[str, Callable[[Request], Answer | None]],
    ) -> None:
        self._begin, self._log = begin, node.get_logger()
        self._answers = Answers(node, answers)
        self.pending: dict[str, Request] = {}  # requests under way, by what they do
        node.create_subscription(String, topic, self._called, interface.REQUESTS)

    def finish(self, do: str, answer: Answer) -> None:
        """Answer the request under way to do something."""
        self._answers.give(self.pending.pop(do).id, answer)

    def _called(self, message: String) -> None:
        try:
            asked = request(message.data)
        except ValueError as error:
            self._log.warning(f"request ignored: {error}", throttle_duration_sec=1.0)
            return
        if self._answers.is_new(asked.id):
            answer = self._taken(asked)
            if answer is None:
                self.pending[asked.do] = asked
                answer = Answer(Code.BEGUN)
            self._answers.give(asked.id, answer)

    def _taken(self, asked: Request) -> Answer | None:
        if asked.do not in self._begin:
            return Answer(Code.REFUSED, f"{asked.do!r} must be one of {sorted(self._begin)}")
        if asked.do in self.pending:
            return Answer(Code.BUSY, "refused: the previous request is under way")
        try:
            return self._begin[asked.do](asked)
        except ValueError as error:
            self._log.warning(f"request refused: {error}")
            return Answer(Code.REFUSED, str(error))
