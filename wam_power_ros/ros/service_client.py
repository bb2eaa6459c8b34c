# SPDX-License-Identifier: Apache-2.0
"""Calling services from a script that has nothing else to do meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

TIMEOUT = 60.0  # for a service to appear and to agree [s of wall time]
# A client knows that it sees the service, not that the service sees it: the middleware drops an
# answer to a client that it has not discovered within 0.1 s.
DISCOVERY = 0.3  # [s of wall time]


class ServiceError(RuntimeError):
    """It cannot go on; the message says which service did what."""


class ServiceCalls:
    """Calls services for a node, and dispatches its callbacks while it waits."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._clients: dict[str, Client] = {}

    def begin(self, kind: type, name: str, request: object = None) -> Future:
        """Call a service; its answer comes when it comes.

        Raises:
            ServiceError: It does not appear in time.
        """
        known = name in self._clients
        if not known:
            self._clients[name] = self._node.create_client(kind, name)
        client = self._clients[name]
        if not client.wait_for_service(TIMEOUT):
            raise ServiceError(f"{name} did not appear in {TIMEOUT:.0f} s")
        if not known:
            time.sleep(DISCOVERY)
        return client.call_async(kind.Request() if request is None else request)

    def until(self, condition: Callable[[], bool], patience: float = TIMEOUT) -> bool:
        """Whether it came true within `patience` [s]."""
        end = time.monotonic() + patience
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.05)
        return True

    def call(
        self, kind: type, name: str, request: object = None, patience: float = TIMEOUT
    ) -> Trigger.Response | SetBool.Response:
        """Answer of a service, which may be a refusal.

        Raises:
            ServiceError: It does not appear, or does not answer within `patience` [s].
        """
        future = self.begin(kind, name, request)
        if not self.until(future.done, patience):
            raise ServiceError(f"{name} did not answer in {patience:.0f} s")
        return future.result()

    def insist(self, kind: type, name: str, request: object = None) -> str:
        """Message of a service that agreed.

        A refusal is asked again until the time is up: a node that has just started may not have
        seen a joint state yet.

        Raises:
            ServiceError: It does not appear, does not answer in time, or refuses.
        """
        end = time.monotonic() + TIMEOUT
        while True:
            answer = self.call(kind, name, request, max(end - time.monotonic(), 1.0))
            if answer.success:
                return str(answer.message)
            if time.monotonic() > end:
                raise ServiceError(f"{name} refused: {answer.message}")
            time.sleep(0.2)
