# SPDX-License-Identifier: Apache-2.0
"""Calls of other nodes' services with timeouts; callbacks are dispatched during the wait."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from rclpy.client import Client
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from wam_power_ros.ros import answers, interrupts
from wam_power_ros.ros.answers import Answer

TIMEOUT = 60.0  # [s of wall time] for a service to appear, to answer and to succeed
# A client that has discovered a service may not be discovered by it yet: the middleware drops an
# answer to a client that it has not discovered within 0.1 s.
DISCOVERY = 0.3  # [s of wall time]
LOG_AFTER = 5.0  # [s of wall time] of waiting before it is logged
LOG_PERIOD = 60.0  # [s of wall time] between log entries about one wait
RETRY_PERIOD = 0.2  # [s of wall time] between a refusal and the next request


class ServiceError(RuntimeError):
    """A service did not appear, did not answer or refused; the message names it."""


class ServiceClient:
    """Calls services for a node.

    Args:
        node: Node that calls.
        executor: Executor that has the node; one is made if omitted.
        appear_timeout: Time for a service to appear [s of wall time].
        log_period: Time between two log entries about one wait [s of wall time].
    """

    def __init__(
        self,
        node: Node,
        executor: Executor | None = None,
        appear_timeout: float = TIMEOUT,
        log_period: float = LOG_PERIOD,
    ) -> None:
        self._node = node
        if executor is None:
            executor = SingleThreadedExecutor(context=node.context)
            executor.add_node(node)
        self._executor = executor
        self._appear_timeout, self._log_period = appear_timeout, log_period
        self._clients: dict[str, Client] = {}
        self._called: set[str] = set()
        self._pending: dict[Future, Client] = {}

    def prepare(self, kind: type, name: str) -> None:
        """Make the client of a service before its first call, so that it is discovered early."""
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name)

    def until(
        self,
        condition: Callable[[], object],
        what: str | Callable[[], str] = "",
        timeout: float = TIMEOUT,
    ) -> bool:
        """Dispatch callbacks until a condition holds or the timeout is over.

        Args:
            condition: Condition, checked after every callback and at least every 0.05 s.
            what: Noun phrase for the log, or a function that returns it at the time of logging;
                nothing is logged if empty.
            timeout: Longest wait [s of wall time].

        Returns:
            True if the condition holds, False after the timeout.

        Raises:
            ExternalShutdownException: When the process is being ended.
        """
        begun, log_at = time.monotonic(), LOG_AFTER if what else math.inf
        while not condition():
            if not self._node.context.ok():
                raise ExternalShutdownException
            waited = time.monotonic() - begun
            if waited > timeout:
                return False
            if waited > log_at:
                awaited = what() if callable(what) else what
                self._node.get_logger().info(f"waiting for {awaited}, {waited:.0f} s so far")
                log_at = waited + self._log_period
            interrupts.spin_once(self._executor, min(0.05, timeout - waited))
        return True

    def wait_for(self, kind: type, name: str) -> None:
        """Wait for a service, however long it takes to appear.

        Raises:
            ExternalShutdownException: When the process is being ended.
        """
        self.prepare(kind, name)
        self.until(self._clients[name].service_is_ready, f"service {self._full(name)}", math.inf)

    def _full(self, name: str) -> str:
        """Name of a service with its namespace, for messages."""
        return self._node.resolve_service_name(name)

    def begin(self, kind: type, name: str, request: object = None) -> Future:
        """Send a request; see `answer` for what to do with the future.

        Raises:
            ServiceError: When the service does not appear in time.
        """
        self.prepare(kind, name)
        client, full = self._clients[name], self._full(name)
        known = name in self._called and client.service_is_ready()
        if not self.until(client.service_is_ready, f"service {full}", self._appear_timeout):
            raise ServiceError(f"{full} did not appear in {self._appear_timeout:.0f} s")
        if not known:  # the first call, or the node of the service has just been restarted
            self._called.add(name)
            self.until(lambda: False, timeout=DISCOVERY)
        future = client.call_async(kind.Request() if request is None else request)
        self._pending[future] = client
        return future

    def answer(self, future: Future) -> Answer | None:
        """Answer received so far; if None, the request is abandoned and its answer ignored."""
        client = self._pending.pop(future)
        if not future.done():
            client.remove_pending_request(future)
            return None
        response = future.result()
        message = getattr(response, "message", "")  # of a transition: none
        return answers.read(response.success, message)

    def call(
        self,
        kind: type,
        name: str,
        request: object = None,
        timeout: float = TIMEOUT,
        abandon: Callable[[], bool] = lambda: False,
    ) -> Answer | None:
        """Call a service.

        Args:
            kind: Type of the service, of std_srvs, or `ChangeState`.
            name: Name of the service.
            request: Request; an empty one if omitted.
            timeout: Longest wait for the answer [s of wall time].
            abandon: Returns True to stop waiting earlier; checked after every callback.

        Returns:
            The answer, which may be a refusal; None if none came. The request may have been done
            even so: the answer is lost if the node is restarted while it works on the request.

        Raises:
            ServiceError: When the service does not appear in time.
        """
        future = self.begin(kind, name, request)
        self.until(lambda: future.done() or abandon(), f"answer of {self._full(name)}", timeout)
        return self.answer(future)

    def insist(self, kind: type, name: str, request: object = None) -> Answer:
        """Call a service until it succeeds; a node that has just started may lack inputs.

        Raises:
            ServiceError: When the service does not appear, does not answer or still refuses after
                TIMEOUT.
        """
        end = time.monotonic() + TIMEOUT
        while True:
            answer = self.call(kind, name, request, max(end - time.monotonic(), 1.0))
            if answer is None:
                raise ServiceError(f"{self._full(name)} did not answer in {TIMEOUT:.0f} s")
            if answer.success:
                return answer
            if time.monotonic() > end:
                raise ServiceError(f"{self._full(name)} refused: {answer.text}")
            self.until(lambda: False, timeout=RETRY_PERIOD)
