# SPDX-License-Identifier: Apache-2.0
"""Client for the services of other nodes: timeouts, refusals, lost answers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest
import rclpy
from conftest import Probe
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.service import Service
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.ros import service_client
from wam_power_ros.ros.answers import Answer, Code
from wam_power_ros.ros.deferred_service import DeferredTrigger
from wam_power_ros.ros.service_client import ServiceClient, ServiceError

Serve = Callable[[str, Callable[[], Answer | None]], DeferredTrigger | None]


@pytest.fixture
def serve(domain_id: int) -> Iterator[Serve]:
    """Offers services in a thread: the function returns the answer, or None to never answer."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain_id)
    node = rclpy.create_node("server", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def offer(name: str, answer: Callable[[], Answer | None]) -> DeferredTrigger:
        def begin() -> str | None:
            given = answer()
            return None if given is None else str(given)

        return DeferredTrigger(node, name, begin)

    over = threading.Event()

    def work() -> None:
        while not over.is_set():
            executor.spin_once(timeout_sec=0.02)

    thread = threading.Thread(target=work)
    thread.start()
    yield offer
    over.set()
    thread.join()
    rclpy.shutdown(context=context)


def test_an_answer_comes_with_its_code_and_its_values(probe: Probe, serve: Serve) -> None:
    given = Answer(Code.NOT_AT_START, "the arm is 0.2 rad away", {"policy": "trial-3"})
    serve("/ask", lambda: given)
    assert ServiceClient(probe.node).call(Trigger, "/ask") == given


def test_a_request_may_carry_something(probe: Probe, domain_id: int) -> None:
    def flip(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = request.data, str(Answer(Code.DONE, "on"))
        return response

    probe.node.create_service(SetBool, "/switch", flip)  # dispatched by the client
    client = ServiceClient(probe.node)
    assert client.call(SetBool, "/switch", SetBool.Request(data=True)) == Answer(Code.DONE, "on")


def test_no_answer_in_time_is_none_and_does_not_answer_the_next_request(
    probe: Probe, serve: Serve
) -> None:
    late = serve("/late", lambda: None)
    client = ServiceClient(probe.node)
    assert client.call(Trigger, "/late", timeout=0.3) is None
    (only,) = probe.node.clients
    assert not only._pending_requests  # an abandoned request is deleted
    second = client.begin(Trigger, "/late")
    client.until(lambda: len(late._headers) == 2, "both requests")
    late.finish(True, str(Answer(Code.DONE, "now")))
    assert client.until(second.done, "the second answer", 10.0)
    assert client.answer(second) == Answer(Code.DONE, "now")


def test_waiting_ends_early_when_there_is_no_point_in_it(probe: Probe, serve: Serve) -> None:
    serve("/never", lambda: None)
    client = ServiceClient(probe.node)
    begun = time.monotonic()
    assert client.call(Trigger, "/never", abandon=lambda: time.monotonic() > begun + 0.6) is None
    assert time.monotonic() - begun < 10.0


def test_a_service_that_does_not_appear_is_named(probe: Probe) -> None:
    client = ServiceClient(probe.node, appear_timeout=0.2)
    with pytest.raises(ServiceError, match="/nowhere did not appear"):
        client.call(Trigger, "/nowhere")


def test_only_the_first_call_of_a_service_that_has_started_waits_to_be_discovered(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return response

    def start() -> None:
        services.append(probe.node.create_service(Trigger, "/ask", answer))
        timer.cancel()

    services: list[Service] = []
    timer = probe.node.create_timer(0.2, start)
    client = ServiceClient(probe.node)
    client.prepare(Trigger, "/ask")
    waits: list[float] = []
    until = client.until

    def noted(condition: Callable[[], object], what: str = "", timeout: float = 60.0) -> bool:
        waits.append(timeout)
        return until(condition, what, timeout)

    monkeypatch.setattr(client, "until", noted)
    client.call(Trigger, "/ask")
    client.call(Trigger, "/ask")
    assert waits.count(service_client.DISCOVERY) == 1
    probe.node.destroy_service(services.pop())
    timer.reset()
    client.call(Trigger, "/ask")
    assert waits.count(service_client.DISCOVERY) == 2


def test_a_refusal_is_asked_again_until_it_is_an_agreement(probe: Probe, serve: Serve) -> None:
    refusals = [Answer(Code.NOTHING, "no joint state yet")] * 2
    serve("/ask", lambda: refusals.pop() if refusals else Answer(Code.DONE, "done now"))
    assert ServiceClient(probe.node).insist(Trigger, "/ask") == Answer(Code.DONE, "done now")


@pytest.mark.parametrize(
    ("answer", "says"),
    [(Answer(Code.REFUSED, "never"), "/ask refused: never"), (None, "/ask did not answer")],
)
def test_a_service_that_never_agrees_is_reported(
    answer: Answer | None,
    says: str,
    probe: Probe,
    serve: Serve,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(service_client, "TIMEOUT", 0.5)
    serve("/ask", lambda: answer)
    with pytest.raises(ServiceError, match=says):
        ServiceClient(probe.node, appear_timeout=30.0).insist(Trigger, "/ask")


def test_a_long_wait_is_logged_once_with_what_it_is_for(
    probe: Probe, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(service_client, "LOG_AFTER", 0.1)
    client = ServiceClient(probe.node)
    assert not client.until(lambda: False, "the return of the cows", 0.4)
    assert not client.until(lambda: False, timeout=0.4)
    assert capfd.readouterr().err.count("waiting for the return of the cows") == 1


def test_a_wait_ends_with_the_process(domain_id: int) -> None:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain_id)
    client = ServiceClient(rclpy.create_node("caller", context=context))
    rclpy.shutdown(context=context)
    with pytest.raises(ExternalShutdownException):
        client.until(lambda: False, "nothing", 30.0)
