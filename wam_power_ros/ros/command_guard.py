# SPDX-License-Identifier: Apache-2.0
"""Guard of a command topic against a second commander."""

from __future__ import annotations

import time
from collections import deque

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from wam_power_ros.ros import interface

SILENCE = 0.5  # [s] without a command after which an announced commander counts as gone
_OWN = 100  # own commands that may come back


class CommandGuard:
    """Listens to the topic while we send nothing, and counts its publishers while we send.

    A commander that was killed stays announced for 20 s: one that does not send does not keep us
    from starting, but is listened to until it is gone. One that appears later is a fault.

    Attributes:
        foreign: True once another publisher has sent a command since we began to send.

    Args:
        node: Node that sends.
        publisher: Its publisher on the command topic.
    """

    def __init__(self, node: Node, publisher: Publisher) -> None:
        self._node, self._publisher = node, publisher
        self._received = -SILENCE  # when the last command of another came [s, steady clock]
        self._known = 0  # other publishers
        self._own: deque[bytes] = deque(maxlen=_OWN)  # commands that were sent while we listen
        self._subscription: Subscription | None = None
        self.foreign = False
        self.listen()

    def listen(self) -> None:
        """Listen for commands of others."""
        if self._subscription is None:
            self._subscription = self._node.create_subscription(
                self._publisher.msg_type,
                self._publisher.topic_name,
                self._on_command,
                interface.STATE_IN,
                raw=True,
            )

    def begin(self) -> str | None:
        """Begin to send; returns why that is not possible yet, or None."""
        if time.monotonic() - self._received < SILENCE:
            return f"another publisher commands on {self._publisher.topic_name}"
        self.foreign = False
        self._known = self._others()
        self._forget()
        return None

    def publish(self, command: bytes) -> None:
        """Send a command."""
        if self._subscription is not None:
            self._own.append(command)
        self._publisher.publish(command)

    def intruder(self) -> str | None:
        """Text about a publisher that has appeared since the last call, or None; while we send."""
        others, known = self._others(), self._known
        self._known = others
        self._forget()
        return None if others <= known else f"{others} other publishers on the command topic"

    def _forget(self) -> None:
        """End listening when there is nobody to be heard."""
        if self._known == 0 and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
            self._own.clear()

    def _others(self) -> int:
        return self._node.count_publishers(self._publisher.topic_name) - 1

    def _on_command(self, command: bytes) -> None:
        if not any(command.startswith(own) for own in reversed(self._own)):
            self._received, self.foreign = time.monotonic(), True
