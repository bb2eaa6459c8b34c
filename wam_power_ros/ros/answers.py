# SPDX-License-Identifier: Apache-2.0
"""What a service answers: a code and values for machines, a sentence for people.

std_srvs has only `success` and `message`. A message of ours reads

    [code key=value ...] Sentence.

so that nothing has to be decided by the words of the sentence.
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
    REFUSED = "refused"  # for a reason that only a person needs to know
    NOT_ACTIVE = "not_active"  # the node is not configured or not active
    FAULT = "fault"  # a fault is latched, or came before the request was done
    BUSY = "busy"  # something else is under way
    NOTHING = "nothing"  # what the request is about has not come yet: a policy, a bag, ...
    NOT_AT_START = "not_at_start"  # value `policy`: the arm is not where a rollout of it begins
    SWITCH = "switch"  # the enabling switch is not held
    TOO_FAST = "too_fast"  # value `speed`: at which the replay would be possible
    STOPPED = "stopped"  # a person, or another request, ended it
    UNKNOWN = "unknown"  # an answer that is not of this form: another package's service


@dataclass(frozen=True)
class Answer:
    """An answer of a service.

    Attributes:
        code: Outcome of the request.
        text: Sentence for a person; may be empty.
        values: Values by name, without spaces, such as the id of the policy.
    """

    code: Code
    text: str = ""
    values: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key, value in self.values.items():
            if not re.fullmatch(r"\w+", key) or not re.fullmatch(r"[^\s\]]+", value):
                raise ValueError(f"value {key}={value!r} of an answer must be words without spaces")

    @property
    def success(self) -> bool:
        """Whether the request was done."""
        return self.code is Code.DONE

    def __str__(self) -> str:
        """Text of the message."""
        head = " ".join(
            [self.code.value, *(f"{key}={value}" for key, value in self.values.items())]
        )
        return f"[{head}] {self.text}".rstrip()


def read(success: bool, message: str) -> Answer:
    """Answer in a response of std_srvs.

    Args:
        success: Field of the response.
        message: Field of the response.

    Returns:
        The answer; of a message that is not of our form, DONE or UNKNOWN by `success`, with the
        message as its text.
    """
    form = _FORM.fullmatch(message)
    code = form.group(1) if form else ""
    if form is None or code not in {known.value for known in Code}:
        return Answer(Code.DONE if success else Code.UNKNOWN, message)
    pairs = (pair.partition("=") for pair in form.group(2).split())
    return Answer(Code(code), form.group(3) or "", {key: value for key, _, value in pairs})
