# SPDX-License-Identifier: Apache-2.0
"""Guards a command topic against a second commander."""

from __future__ import annotations

import time

from rclpy.node import Node
from rclpy.publisher import Publisher

from wam_power_ros.ros import interface

SILENCE = 0.5  # [s] after which a commander that is still announced counts as gone


class SoleCommander:
    """Listens to the topic while we are silent, and counts its publishers while we are not.

    A commander that was killed stays announced for 20 s: one that does not send does not keep us
    from starting, one that appears later is a fault.
    """

    def __init__(self, node: Node, publisher: Publisher) -> None:
        self._node, self._publisher = node, publisher
        self._heard = -SILENCE
        self._known = 0
        self._subscription = None
        self.listen()

    def listen(self) -> None:
        """We are silent now: whatever comes is another's."""
        if self._subscription is None:
            self._subscription = self._node.create_subscription(
                self._publisher.msg_type, self._publisher.topic_name, self._hear, interface.STATE_IN
            )

    def begin(self) -> str | None:
        """We want to send; a text says why not yet."""
        if time.monotonic() - self._heard < SILENCE:
            return f"another publisher commands on {self._publisher.topic_name}"
        self._node.destroy_subscription(self._subscription)
        self._subscription = None
        self._known = self._others()
        return None

    def intruder(self) -> str | None:
        """While we send: a text when a publisher has appeared that was not there."""
        others, known = self._others(), self._known
        self._known = others
        return None if others <= known else f"{others} other publishers on the command topic"

    def _others(self) -> int:
        return self._node.count_publishers(self._publisher.topic_name) - 1

    def _hear(self, _: object) -> None:
        self._heard = time.monotonic()
