# SPDX-License-Identifier: Apache-2.0
"""Answers of services: a code and values for programs, a sentence for people.

A response of std_srvs has only `success` and `message`. The messages of these nodes read

    [code key=value ...] Sentence.

so that no program depends on the words of the sentence.
"""

from __future__ import annotations

import enum
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

_FORM = re.compile(r"\[(\w+)((?: \w+=\S+)*)\](?: (.*))?", re.DOTALL)


class Code(str, enum.Enum):
    """Outcome of a request."""

    DONE = "done"
    BEGUN = "begun"  # another answer to the same request will follow
    REFUSED = "refused"  # for a reason that only the sentence gives
    NOT_ACTIVE = "not_active"  # the node is not configured or not active
    FAULT = "fault"  # a fault is latched, or occurred before the request was done
    BUSY = "busy"  # another request is in progress
    NOTHING = "nothing"  # an input has not been received yet: a policy, a bag, ...
    NOT_AT_START = "not_at_start"  # the arm is not at the start of the policy in value `policy`
    SWITCH = "switch"  # the enabling switch is not held
    TOO_FAST = "too_fast"  # value `speed`: at which the replay would be possible
    STOPPED = "stopped"  # ended, by a person if value `stop` is the id of a stop
    UNKNOWN = "unknown"  # the message is not of this form: another package's service


@dataclass(frozen=True)
class Answer:
    """An answer of a service."""

    code: Code
    text: str = ""  # sentence for a person
    values: Mapping[str, str] = field(default_factory=dict)  # such as the id of the policy

    @property
    def success(self) -> bool:
        """True if the request was done."""
        return self.code is Code.DONE

    @property
    def said(self) -> str:
        """Sentence for a person, or the code if there is none."""
        return self.text or self.code.value

    def __str__(self) -> str:
        """Text of the message.

        Raises:
            ValueError: When a key is no word, or a value has a space or "]".
        """
        for key, value in self.values.items():
            if not re.fullmatch(r"\w+", key) or not re.fullmatch(r"[^\s\]]+", value):
                raise ValueError(
                    f"{key}={value!r} in an answer: key must be a word, value without space or ']'"
                )
        head = " ".join(
            [self.code.value, *(f"{key}={value}" for key, value in self.values.items())]
        )
        return f"[{head}] {self.text}".rstrip()


NOT_ACTIVE = Answer(Code.NOT_ACTIVE, "refused: the controller is not active")


class ServiceError(RuntimeError):
    """A service did not appear, did not answer or refused; the message names it.

    Attributes:
        answer: Refusal; None without an answer.
    """

    def __init__(self, text: str, answer: Answer | None = None) -> None:
        super().__init__(text)
        self.answer = answer


def read(success: bool, message: str) -> Answer:
    """Read the answer in a response of std_srvs.

    Args:
        success: Field of the response.
        message: Field of the response.

    Returns:
        The answer; for a message of another form, DONE or UNKNOWN by `success` and the message as
        text.
    """
    form = _FORM.fullmatch(message)
    if form is None or form.group(1) not in [code.value for code in Code]:
        return Answer(Code.DONE if success else Code.UNKNOWN, message)
    pairs = (pair.partition("=") for pair in form.group(2).split())
    return Answer(Code(form.group(1)), form.group(3) or "", {key: value for key, _, value in pairs})
