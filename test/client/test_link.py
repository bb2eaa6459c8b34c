# SPDX-License-Identifier: Apache-2.0
"""Requests to the services of other nodes: timeouts, refusals, lost answers, threads."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator

import pytest
import rclpy
from conftest import Probe
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from wam_power_interfaces.srv import Pause
from wam_power_ros.client import link as links
from wam_power_ros.client.link import Link
from wam_power_ros.ros import interface
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError, fill

Serve = Callable[[str, Callable[[], Answer | None]], Callable[[], int]]


@pytest.fixture
def serve(probe: Probe) -> Iterator[Serve]:
    """Offers services: the function returns the answer, or None to answer late, on demand."""
    node = rclpy.create_node("server", context=probe.context)

    def offer(name: str, answer: Callable[[], Answer | None]) -> Callable[[], int]:
        def called(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response | None:
            given = answer()
            return None if given is None else fill(response, given)

        waiting: list[object] = []
        service = node.create_service(Trigger, name, called)
        send = service.send_response

        def send_or_keep(response: Trigger.Response | None, header: object) -> None:
            waiting.append(header) if response is None else send(response, header)

        def finish() -> int:
            """Answer all requests once there are two; returns how many there are."""
            for header in waiting if len(waiting) > 1 else ():
                send(Trigger.Response(success=True, message="now"), header)
            return len(waiting)

        service.send_response = send_or_keep
        return finish

    with Link(node):
        yield offer


@pytest.fixture
def link(probe: Probe) -> Iterator[Link]:
    with Link(rclpy.create_node("caller", context=probe.context)) as link:
        yield link


def test_a_request_may_carry_something(link: Link) -> None:
    def flip(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = request.data, "on"
        return response

    def pause(request: Pause.Request, response: Pause.Response) -> Pause.Response:
        response.success = response.under_way = request.pause
        return response

    link.node.create_service(SetBool, "/switch", flip)
    link.node.create_service(Pause, "/pause", pause)
    assert link.call("/switch", True) == Answer(Code.DONE, "on")
    assert link.call("/pause", Pause.Request(pause=True)) == Answer(Code.DONE, under_way=True)


def test_requests_of_several_threads_are_answered_each_with_its_own(
    link: Link, serve: Serve
) -> None:
    names = [f"/ask_{number}" for number in range(4)]
    for name in names:
        serve(name, lambda name=name: Answer(Code.DONE, name))
    found: dict[str, str] = {}

    def ask(name: str) -> None:
        found[name] = link.call(name).text

    threads = [threading.Thread(target=ask, args=(name,)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == dict(zip(names, names, strict=True))


def test_no_answer_in_time_is_none_and_does_not_answer_the_next_request(
    link: Link, serve: Serve
) -> None:
    finish = serve("/late", lambda: None)
    assert link.call("/late", timeout=0.3) is None
    (only,) = link.node.clients
    assert not only._pending_requests  # an abandoned request is deleted

    both = lambda: link.until(lambda: finish() == 2, "both requests")  # noqa: E731
    threading.Thread(target=both).start()
    assert link.call("/late") == Answer(Code.DONE, "now")


def test_a_service_that_does_not_appear_is_named(probe: Probe) -> None:
    node = rclpy.create_node("caller", context=probe.context)
    with (
        Link(node, appear_timeout=0.2) as link,
        pytest.raises(ServiceError, match="/nowhere did not appear"),
    ):
        link.call("/nowhere")


def test_only_a_service_that_has_just_appeared_is_given_time_to_discover_its_client(
    link: Link, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "DISCOVERY", 1.0)

    def time_of_a_call() -> float:
        begun = time.monotonic()
        assert link.call("/ask") is not None
        return time.monotonic() - begun

    service = link.node.create_service(Trigger, "/ask", lambda _, response: response)
    assert time_of_a_call() > 1.0
    assert time_of_a_call() < 1.0
    link.node.destroy_service(service)
    assert link.until(lambda: not link.offers("/ask"))
    link.node.create_service(Trigger, "/ask", lambda _, response: response)
    assert time_of_a_call() > 1.0


def test_a_refusal_is_asked_again_until_it_is_an_agreement(link: Link, serve: Serve) -> None:
    refusals = [Answer(Code.NOTHING, "no joint state yet")] * 2
    serve("/ask", lambda: refusals.pop() if refusals else Answer(Code.DONE, "done now"))
    assert link.call("/ask") == Answer(Code.UNKNOWN, "no joint state yet")
    assert link.call_until_success("/ask") == Answer(Code.DONE, "done now")


def test_a_service_that_never_agrees_is_reported_with_its_answer(
    link: Link, serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "TIMEOUT", 0.5)
    for name, answer, says in (
        ("/refuse", Answer(Code.REFUSED, "never"), "/refuse refused: never"),
        ("/ignore", None, "/ignore did not answer"),
    ):
        serve(name, lambda answer=answer: answer)
        with pytest.raises(ServiceError, match=says) as raised:
            link.call_until_success(name)
        assert raised.value.answer == (answer and Answer(Code.UNKNOWN, answer.text))


def test_a_wait_ends_with_the_link_and_with_its_context(domain_id: int) -> None:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain_id)
    with Link(rclpy.create_node("caller", context=context)) as link:
        link.prepare("/ask")
    for _ in range(2):
        with pytest.raises(ExternalShutdownException):
            link.until(lambda: False, "nothing", 30.0)
        assert not link.offers("/ask")
        rclpy.try_shutdown(context=context)


def test_an_error_of_a_callback_is_raised_by_who_waits(link: Link, serve: Serve) -> None:
    def fail(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        raise OSError("the disk is gone")

    link.node.create_service(Trigger, "/fail", fail)
    with pytest.raises(OSError, match="the disk is gone"):
        link.call("/fail")


def test_a_message_that_is_refused_is_logged_and_the_next_one_received(
    link: Link, probe: Probe, capfd: pytest.CaptureFixture[str]
) -> None:
    heard: list[str] = []

    def hear(message: String) -> None:
        if message.data == "nonsense":
            raise ValueError("'nonsense' makes no sense")
        heard.append(message.data)

    link.listen(String, "/words", hear, interface.LATCHED)
    words = probe.publisher(String, "/words", interface.LATCHED)
    for word in ("nonsense", "sense"):
        words.publish(String(data=word))
        probe.spin(0.2)
    assert link.until(lambda: heard == ["sense"])
    assert "message ignored: 'nonsense' makes no sense" in capfd.readouterr().err


def test_the_newest_message_is_taken_once_without_a_service_or_a_callback(
    link: Link, probe: Probe
) -> None:
    take = link.poll_latest(String, "/words")
    words = probe.publisher(String, "/words", interface.LATCHED)
    for word in ("first", "last"):
        words.publish(String(data=word))
        probe.spin(0.2)
    assert take().data == "last"
    assert take() is None
    offered = probe.node.get_service_names_and_types_by_node("caller_states", "/")
    assert offered == []


def test_a_signal_interrupts_a_wait_at_once(link: Link) -> None:
    waking = threading.Timer(0.3, lambda: signal.raise_signal(signal.SIGINT))
    waking.start()
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        link.until(lambda: False, timeout=30.0)
    assert time.monotonic() - begun < 10.0
    waking.join()
