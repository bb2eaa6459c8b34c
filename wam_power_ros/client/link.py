# SPDX-License-Identifier: Apache-2.0
"""Requests to other nodes and waits for their answers and messages.

The rule for threads: within its `with` block a `Link` has one thread, which alone dispatches the
callbacks of its node. Every other thread may call any method, and blocks until the answer or a
timeout. So a signal interrupts the main thread in a wait, never the middleware.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from wam_power_interfaces.srv import AddDemonstration, Pause, Rate
from wam_power_ros.ros import interface
from wam_power_ros.ros.node_runner import executor_for
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError

TIMEOUT = 60.0  # [s of wall time] for a service to appear, to answer and to succeed
# A client that has discovered a service may not be discovered by it yet: the middleware drops an
# answer to a client that it has not discovered within 0.1 s.
DISCOVERY = 0.3  # [s of wall time]
LOG_AFTER = 5.0  # [s of wall time] of waiting before it is logged
LOG_PERIOD = 60.0  # [s of wall time] between log entries about one wait
RETRY_PERIOD = 0.2  # [s of wall time] between a refusal and the next request
DISPATCH_PERIOD = 0.1  # [s of wall time] in which the thread notices that it shall end
CHECK_PERIOD = 0.05  # [s of wall time] between two checks of what is waited for
NEWEST = interface.qos(1, "BEST_EFFORT")
# Of a request: of a SetBool, a ChangeState, a Trigger; or a whole request of another type.
Data = bool | Transition | Pause.Request | AddDemonstration.Request | Rate.Request | None


class Link:
    """Calls services of other nodes and waits for conditions, for a node that nothing else spins.

    A context manager, which ends its thread. Times are [s of wall time]: `appear_timeout` for a
    service to appear, `log_period` between two log entries about one wait.
    """

    def __init__(
        self, node: Node, appear_timeout: float = TIMEOUT, log_period: float = LOG_PERIOD
    ) -> None:
        self.node = node
        self.appear_timeout, self.log_period = appear_timeout, log_period
        self._clients: dict[str, Client] = {}
        self._ready_times: dict[str, float] = {}  # since when a service has been seen ready
        self._changed = threading.Condition()  # notified of every message and answer
        self._ended = False
        self._error: Exception | None = None  # of a callback, whose thread it ends; or see `fail`
        self._executor: Executor
        self._thread = threading.Thread(target=self._dispatch, name="callbacks", daemon=True)

    def __enter__(self) -> Link:
        self._executor = executor_for(self.node)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended = True
        self._thread.join()

    def _dispatch(self) -> None:
        try:
            try:
                while not self._ended:
                    self._executor.spin_once(timeout_sec=DISPATCH_PERIOD)
            finally:
                self._executor.shutdown()
        except Exception as error:  # raised by the waits of other threads
            self._error = error

    def fail(self, error: Exception) -> None:
        """Let every wait raise an error from now on, as when a node has ended."""
        self._error = error

    def schedule(self, work: Callable[[], object]) -> Future:
        """Let short work be done by the thread that dispatches the callbacks.

        A client of an action keeps a request only after it has sent it: in another thread the
        response may come first, and would be ignored.
        """
        task = self._executor.create_task(work)
        task.add_done_callback(self.notify)
        return task

    def until(
        self,
        condition: Callable[[], object],
        what: str | Callable[[], str] = "",
        timeout: float = TIMEOUT,
    ) -> bool:
        """Wait until a condition holds; False after the timeout [s of wall time].

        `what` is a noun phrase for the log, or returns it; nothing is logged if it is empty.

        Raises:
            ExternalShutdownException: The node is being ended.
            Exception: One that a callback has raised, or of `fail`.
        """
        begun, log_at = time.monotonic(), LOG_AFTER if what else math.inf
        with self._changed:
            while not condition():
                if self._error is not None:
                    raise self._error
                if self._ended or not self.node.context.ok():
                    raise ExternalShutdownException
                waited = time.monotonic() - begun
                if waited > timeout:
                    return False
                if waited > log_at:
                    awaited = what() if callable(what) else what
                    self.node.get_logger().info(f"waiting for {awaited}, {waited:.0f} s so far")
                    log_at = waited + self.log_period
                self._changed.wait(min(CHECK_PERIOD, timeout - waited))
        return True

    def notify(self, _: object = None) -> None:
        """Let every wait look again at what it waits for."""
        with self._changed:
            self._changed.notify_all()

    def sleep(self, seconds: float) -> None:
        """Wait for some time [s of wall time]."""
        self.until(lambda: False, timeout=seconds)

    # Topics

    def listen(
        self, kind: type, topic: str, then: Callable[[Any], object], qos: QoSProfile
    ) -> None:
        """Subscribe; `then` raises a ValueError for a message that is to be ignored."""

        def received(message: Any) -> None:  # noqa: ANN401 - of any type
            self.read(then, message)
            self.notify()

        self.node.create_subscription(kind, topic, received, qos)

    def last(self, kind: type, topic: str, read: Callable[[Any], Any]) -> Callable[[], Any]:
        """Subscribe to a latched topic; returns a function for what was read last, None before."""
        found: list[Any] = [None]

        def keep(message: Any) -> None:  # noqa: ANN401 - of any type
            found[0] = read(message)

        self.listen(kind, topic, keep, interface.LATCHED)
        return lambda: found[0]

    def read(self, then: Callable[[Any], object], message: Any) -> None:  # noqa: ANN401
        """Call a function with a message; a ValueError is logged."""
        try:
            then(message)
        except ValueError as error:
            log = self.node.get_logger()
            log.warning(f"message ignored: {error}", throttle_duration_sec=1.0)

    def poll_latest(self, kind: type, topic: str) -> Callable[[], Any]:
        """Subscribe; returns a function that takes the newest message not taken yet, or None.

        Callbacks for 500 states a second would use a whole core: its node is not dispatched.
        """
        handle = self._polled.create_subscription(kind, topic, lambda _: None, NEWEST).handle

        def take() -> Any:  # noqa: ANN401 - a message of any type
            with handle:
                taken = handle.take_message(kind, False)
            return None if taken is None else taken[0]

        return take

    @cached_property
    def _polled(self) -> Node:
        return rclpy.create_node(
            f"{self.node.get_name()}_states",
            namespace=self.node.get_namespace(),
            context=self.node.context,
            start_parameter_services=False,
            enable_rosout=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )

    # Services

    def prepare(self, name: str, data: Data = None) -> None:
        """Make the client of a service with such data early, so that it is discovered."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(_request(data)[0], name)

    def offers(self, name: str) -> bool:
        """Whether a service, of which there is a client, is available now."""
        return self._ready(self._full(name), self._clients[name].service_is_ready) is not None

    def _ready(self, name: str, ready: Callable[[], bool]) -> float | None:
        """Time for which a server has been seen ready [s of wall time]; None if it is not."""
        if self._ended or not self.node.context.ok() or not ready():
            self._ready_times.pop(name, None)
            return None
        return time.monotonic() - self._ready_times.setdefault(name, time.monotonic())

    def discovered(self, name: str, ready: Callable[[], bool]) -> bool:
        """Whether a server is ready and has had the time to discover its client."""
        return (self._ready(name, ready) or 0.0) >= DISCOVERY

    def await_server(self, what: str, name: str, ready: Callable[[], bool]) -> None:
        """Wait until a server is `discovered`; a ServiceError says that it does not appear."""
        there, timeout = lambda: self.discovered(name, ready), self.appear_timeout
        if not self.until(there, f"{what} {name}", timeout + DISCOVERY):
            raise ServiceError(f"{name} did not appear in {timeout:.0f} s")

    def _full(self, name: str) -> str:
        return str(self.node.resolve_service_name(name))

    def begin(self, name: str, data: Data = None) -> Future:
        """Send a request; returns the future of the response. A ServiceError if nobody serves."""
        self.prepare(name, data)
        self.await_server("service", self._full(name), self._clients[name].service_is_ready)
        _, request = _request(data)
        future = self._clients[name].call_async(request)
        future.add_done_callback(self.notify)
        return future

    def call(self, name: str, data: Data = None, timeout: float = TIMEOUT) -> Answer | None:
        """Call a service; the answer may be a refusal, and is None if none came in time.

        The request may have been done even so: the answer is lost if the node is restarted while it
        works on the request. A ServiceError if the service does not appear.
        """
        future = self.begin(name, data)
        if not self.until(future.done, f"answer of {self._full(name)}", timeout):
            self._clients[name].remove_pending_request(future)
            return None
        response = future.result()
        code = Code.DONE if response.success else Code.UNKNOWN
        text = getattr(response, "message", "")  # of a transition: none
        return Answer(code, text, under_way=getattr(response, "under_way", False))

    def call_until_success(self, name: str, data: Data = None) -> Answer:
        """Call a service until it succeeds; a node that has just started may lack inputs.

        A ServiceError if it does not appear, does not answer or still refuses after TIMEOUT.
        """
        end = time.monotonic() + TIMEOUT
        while not (answer := self.answer(name, data, max(end - time.monotonic(), 1.0))).success:
            if time.monotonic() > end:
                raise ServiceError(f"{self._full(name)} refused: {answer.text}", answer)
            self.sleep(RETRY_PERIOD)
        return answer

    def answer(self, name: str, data: Data = None, timeout: float = TIMEOUT) -> Answer:
        """Call a service; a ServiceError if it does not answer, as if it does not appear."""
        if (answer := self.call(name, data, timeout)) is None:
            raise ServiceError(f"{self._full(name)} did not answer in {TIMEOUT:.0f} s")
        return answer

    def parameters(self, node: str, names: Sequence[str], timeout: float) -> list[ParameterValue]:
        """Ask a node for parameters, those that it lacks are not set; [] without an answer.

        The timeout [s of wall time] is for the node to appear, and for its answer.
        """
        client = self.node.create_client(GetParameters, f"{node}/get_parameters")
        if not self.until(client.service_is_ready, timeout=timeout):
            return []
        self.sleep(DISCOVERY)
        future = client.call_async(GetParameters.Request(names=names))
        future.add_done_callback(self.notify)
        self.until(future.done, timeout=timeout)
        return list(future.result().values) if future.done() else []


def unanswered(node: Node, name: str, qos: QoSProfile) -> Callable[[], object]:
    """Function that requests a Trigger without waiting for the answer, for a node of its own."""
    client = node.create_client(Trigger, name, qos_profile=qos)
    return lambda: client.call_async(Trigger.Request())


def _request(data: Data) -> tuple[type, object]:
    if data is None:
        return Trigger, Trigger.Request()
    if isinstance(data, Transition):
        return ChangeState, ChangeState.Request(transition=data)
    for kind in (Pause, AddDemonstration, Rate):
        if isinstance(data, kind.Request):
            return kind, data
    return SetBool, SetBool.Request(data=data)
