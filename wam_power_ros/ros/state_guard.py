# SPDX-License-Identifier: Apache-2.0
"""Guard of a topic of joint states against a second publisher of the same joints."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.node import Node

from wam_power_ros.ros import interface

SILENCE_TIMEOUT = 0.5  # [s] after its last state, a publisher counts as gone: another is followed
REMEMBERED = 2.0  # [s] for which a state of another publisher is remembered: some send one a second
SKIPPED_MAX = 1000  # messages of one publisher between two states of the arm: lost, or of others
Info = Mapping[str, int | None]  # information that rclpy gives with a message


def with_info(callback: Callable[[Any, Info], None]) -> Callable[..., None]:
    """Callback of a subscription that gets message and information from any executor.

    The events executor passes them as one tuple, the others as two arguments.
    """
    both = lambda *given: callback(*(given[0] if len(given) == 1 else given))  # noqa: E731
    return functools.wraps(callback)(both)


def _continues(number: int, last: int) -> bool:
    return 0 < number - last <= SKIPPED_MAX


class StateGuard:
    """Follows the publisher whose states are used, and recognises the states of another.

    Several nodes may publish on one topic, each the joints of its own device. Joints that two of
    them publish are in two places. rclpy does not tell who sent a message, but every publisher
    numbers its own: a number that does not continue those of the publisher that is followed is that
    of another one. A killed driver stays announced for 20 s, but sends nothing, so that its
    successor is followed. A middleware that does not number messages (such as Cyclone DDS) hides a
    second publisher.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self._node, self._topic = node, node.resolve_topic_name(topic)
        # Numbers and times [s, steady clock] of the last states: followed, and of another.
        self._number = self._other = 0
        self._heard = self._other_heard = -REMEMBERED
        self._in_turn = False  # the other was heard between two states that were followed

    def follows(self, info: Info, active: bool = False) -> bool:
        """Whether a message with joints of the arm is from the publisher that is followed.

        Args:
            info: Information that came with the message.
            active: Whether torques are sent. A publisher that was heard in turn with the one that
                is followed does not take its place then, however long that one is silent.
        """
        now, number = time.monotonic(), info["publication_sequence_number"]
        if number is None:
            return True
        ours = _continues(number, self._number)
        others = self._in_turn and _continues(number, self._other)
        silent = now - self._heard >= SILENCE_TIMEOUT
        if ours and others:  # of the one whose last number is nearer
            others = self._other >= self._number + (not silent)
            ours = not others
        if (others and active) or not (ours or silent):
            self._other, self._other_heard = number, now
            return False
        self._in_turn |= ours and self._other_heard > self._heard
        self._number, self._heard = number, now
        return True

    def second_publisher(self) -> str | None:
        """Text that names the publishers if another one has sent states, else None."""
        if time.monotonic() - self._other_heard >= REMEMBERED:
            return None
        nodes = ", ".join(interface.publishers(self._node, self._topic))
        return f"more than one publisher sends states of these joints on {self._topic}: {nodes}"
