# SPDX-License-Identifier: Apache-2.0
"""Guard of a command topic against a second commander."""

from __future__ import annotations

import time

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from wam_power_ros.ros import interface

SILENCE = 0.5  # [s] without a command after which an announced commander counts as gone


class SoleCommander:
    """Subscribes to the topic while we send nothing, and counts its publishers while we send.

    A commander that was killed stays announced for 20 s: one that does not send does not keep us
    from starting, one that appears later is a fault.

    Args:
        node: Node that sends.
        publisher: Its publisher on the command topic.
    """

    def __init__(self, node: Node, publisher: Publisher) -> None:
        self._node, self._publisher = node, publisher
        self._received = -SILENCE  # when the last command of another came [s, steady clock]
        self._known = 0  # other publishers
        self._subscription: Subscription | None = None
        self.listen()

    def listen(self) -> None:
        """Watch for commands of others while we send nothing."""
        if self._subscription is None:
            self._subscription = self._node.create_subscription(
                self._publisher.msg_type,
                self._publisher.topic_name,
                self._on_command,
                interface.STATE_IN,
            )

    def begin(self) -> str | None:
        """Begin to send; returns why that is not possible yet, or None."""
        if time.monotonic() - self._received < SILENCE:
            return f"another publisher commands on {self._publisher.topic_name}"
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
        self._known = self._others()
        return None

    def intruder(self) -> str | None:
        """Text about a publisher that has appeared since the last call, or None; while we send."""
        others, known = self._others(), self._known
        self._known = others
        return None if others <= known else f"{others} other publishers on the command topic"

    def _others(self) -> int:
        return self._node.count_publishers(self._publisher.topic_name) - 1

    def _on_command(self, _: object) -> None:
        self._received = time.monotonic()
