# SPDX-License-Identifier: Apache-2.0
"""Guard of a command topic against a second commander."""

from __future__ import annotations

import time
from collections import deque

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from wam_power_ros.ros import interface

SILENCE_TIMEOUT = 0.5  # [s] after its last command, another commander counts as gone
_OWN_MAX = 200  # own commands to recognise when they are received: of 0.2 s at 1 kHz


class CommandGuard:
    """Subscribes to the topic while the node sends nothing; counts its publishers while it sends.

    A killed commander stays announced for 20 s. If it sends nothing, the node may begin to send,
    but stays subscribed until the other is gone. A commander that appears later is a fault.
    """

    def __init__(self, node: Node, publisher: Publisher) -> None:
        self._node, self._publisher = node, publisher
        self._foreign_time = -SILENCE_TIMEOUT  # of another's last command [s, steady clock]
        self._others = 0  # publishers at the last count
        self._own: deque[bytes] = deque(maxlen=_OWN_MAX)  # commands sent while subscribed
        self._subscription: Subscription | None = None
        self.listen()

    @property
    def foreign(self) -> bool:
        """Whether another publisher sends commands, as far as we are subscribed."""
        return time.monotonic() - self._foreign_time < SILENCE_TIMEOUT

    def listen(self) -> None:
        """Subscribe to the commands of others."""
        if self._subscription is None:
            self._subscription = self._node.create_subscription(
                self._publisher.msg_type,
                self._publisher.topic_name,
                self._on_command,
                interface.STATE_IN,
                raw=True,
            )

    def begin(self) -> str | None:
        """Begin to send; returns the reason why this is not possible yet, or None."""
        if self.foreign:
            return f"another publisher sends commands on {self._publisher.topic_name}; end it first"
        self._others = self._count_others()
        self._unsubscribe_if_alone()
        return None

    def publish(self, command: bytes) -> None:
        """Send a command."""
        if self._subscription is not None:
            self._own.append(command)
        self._publisher.publish(command)

    def intruder(self) -> str | None:
        """Text for a fault if publishers have appeared since the last call, else None."""
        others, before = self._count_others(), self._others
        self._others = others
        self._unsubscribe_if_alone()
        if others <= before:
            return None
        return f"{others} other publishers on the command topic {self._publisher.topic_name}"

    def _unsubscribe_if_alone(self) -> None:
        if self._others == 0 and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
            self._own.clear()

    def _count_others(self) -> int:
        return self._node.count_publishers(self._publisher.topic_name) - 1

    def _on_command(self, command: bytes) -> None:
        if not any(command.startswith(own) for own in reversed(self._own)):
            self._foreign_time = time.monotonic()
