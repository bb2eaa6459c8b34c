# SPDX-License-Identifier: Apache-2.0
"""Calling services from a script that has nothing else to do meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

TIMEOUT = 60.0  # for a service to appear and to agree [s of wall time]


class ServiceError(RuntimeError):
    """It cannot go on; the message says which service did what."""


class ServiceCalls:
    """Calls services for a node, and dispatches its callbacks while it waits."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)

    def begin(self, kind: type, name: str, request: object = None) -> Future:
        """Call a service; its answer comes when it comes.

        Raises:
            ServiceError: It does not appear in time.
        """
        client = self._node.create_client(kind, name)
        if not client.wait_for_service(TIMEOUT):
            self._node.destroy_client(client)
            raise ServiceError(f"{name} did not appear in {TIMEOUT:.0f} s")
        future = client.call_async(kind.Request() if request is None else request)
        future.add_done_callback(lambda _: self._node.destroy_client(client))
        return future

    def until(self, condition: Callable[[], bool], patience: float = TIMEOUT) -> bool:
        """Whether it came true within `patience` [s]."""
        end = time.monotonic() + patience
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.05)
        return True

    def insist(self, kind: type, name: str, request: object = None) -> str:
        """Message of a service that agreed.

        A refusal is asked again until the time is up: a node that has just started may not have
        seen a joint state yet.

        Raises:
            ServiceError: It does not appear, does not answer in time, or refuses.
        """
        end = time.monotonic() + TIMEOUT
        while True:
            future = self.begin(kind, name, request)
            if not self.until(future.done, max(end - time.monotonic(), 1.0)):
                raise ServiceError(f"{name} did not answer in {TIMEOUT:.0f} s")
            if future.result().success:
                return str(future.result().message)
            if time.monotonic() > end:
                raise ServiceError(f"{name} refused: {future.result().message}")
            time.sleep(0.2)
