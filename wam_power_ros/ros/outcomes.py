# SPDX-License-Identifier: Apache-2.0
"""Outcomes of requests: a code for programs, a sentence for people.

The result of an action has it as an `Outcome`; a service of std_srvs has only success and sentence.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field
from typing import TypeVar

from std_srvs.srv import SetBool, Trigger

from wam_power_interfaces.msg import Outcome, RolloutEnd
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.ros.stamps import nanoseconds, time_message

Response = TypeVar("Response", SetBool.Response, Trigger.Response)


class Code(str, enum.Enum):
    """Outcome of a request; all but the last are constants of the message `Outcome`."""

    DONE = "done"
    REFUSED = "refused"
    NOT_ACTIVE = "not_active"
    FAULT = "fault"
    BUSY = "busy"
    NOTHING = "nothing"
    NOT_AT_START = "not_at_start"
    SWITCH = "switch"
    TOO_FAST = "too_fast"
    STOPPED = "stopped"
    UNKNOWN = "unknown"  # no answer, or a service that failed for a reason only its text gives


_CODES = {getattr(Outcome, code.name): code for code in Code if code is not Code.UNKNOWN}


@dataclass(frozen=True)
class Answer:
    """Outcome of a request."""

    code: Code
    text: str = ""  # sentence for a person
    stop: str = ""  # id of the stop by which a person ended it, "" if none did
    speed: float = field(default=math.nan, compare=False)  # relative, for a replay TOO_FAST
    under_way: bool = False  # the trial after which a session pauses

    @property
    def success(self) -> bool:
        """True if the request was done."""
        return self.code is Code.DONE

    @property
    def message(self) -> str:
        """Sentence for a person, or the code if there is none."""
        return self.text or self.code.value


NOT_ACTIVE = Answer(Code.NOT_ACTIVE, "refused: the controller is not active")
NO_ANSWER = Answer(Code.UNKNOWN, "no answer")


class ServiceError(RuntimeError):
    """A service or an action did not appear, did not answer or refused; the message names it.

    `answer` is the refusal; None without an answer.
    """

    def __init__(self, text: str, answer: Answer | None = None) -> None:
        super().__init__(text)
        self.answer = answer


def message(answer: Answer) -> Outcome:
    """Message of an outcome."""
    code = getattr(Outcome, answer.code.name)
    return Outcome(code=code, text=answer.text, stop=answer.stop, speed=answer.speed)


def read(outcome: Outcome) -> Answer:
    """Read the message of an outcome; a code of a later version is UNKNOWN."""
    code = _CODES.get(outcome.code, Code.UNKNOWN)
    return Answer(code, outcome.text, outcome.stop, outcome.speed)


def fill(response: Response, answer: Answer) -> Response:
    """Write an outcome into the response of a service."""
    response.success, response.message = answer.success, answer.message
    return response


@dataclass(frozen=True)
class Ended:
    """End of a rollout."""

    policy_id: str
    start_ns: int  # stamp of the start [ns], which the paths have as theirs
    fault: Fault | None  # fault that ended it, None without one
    region: str = ""  # name of the guarded region that ended it, "" if none did
    stop: str = ""  # id of the stop by which a person ended it, "" if none did

    def message(self) -> RolloutEnd:
        """Message that says this."""
        kind, text = (self.fault.kind.value, self.fault.text) if self.fault else ("", "")
        end = RolloutEnd(policy_id=self.policy_id, fault=kind, text=text)
        end.header.stamp, end.region, end.stop = time_message(self.start_ns), self.region, self.stop
        return end

    @classmethod
    def read(cls, end: RolloutEnd) -> Ended:
        """Read a message; a ValueError if the kind of the fault is unknown."""
        fault = Fault(FaultKind(end.fault), end.text) if end.fault else None
        start_ns = nanoseconds(end.header.stamp)
        return cls(end.policy_id, start_ns, fault, end.region, end.stop)
