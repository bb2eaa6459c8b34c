# SPDX-License-Identifier: Apache-2.0
"""A service that answers when the requested movement has ended."""

from __future__ import annotations

from conftest import Probe
from std_srvs.srv import Trigger

from hardware_sim.deferred_service import DeferredTrigger


def test_every_request_is_answered_when_it_is_finished_and_not_before(probe: Probe) -> None:
    late = DeferredTrigger(probe.node, "/late", lambda: None)
    first, second = probe.begin(Trigger, "/late"), probe.begin(Trigger, "/late")
    probe.until(lambda: late.pending, "a request")
    probe.spin(0.3)
    assert not first.done() and not second.done()
    late.finish(True, "there")
    probe.until(lambda: first.done() and second.done(), "both answers")
    for future in (first, second):
        assert (future.result().success, future.result().message) == (True, "there")
    assert not late.pending


def test_a_refusal_is_answered_at_once(probe: Probe) -> None:
    late = DeferredTrigger(probe.node, "/never", lambda: "not today")
    refusal = probe.call(Trigger, "/never")
    assert (refusal.success, refusal.message) == (False, "not today")
    assert not late.pending


def test_a_failure_is_answered_as_one(probe: Probe) -> None:
    late = DeferredTrigger(probe.node, "/late", lambda: None)
    future = probe.begin(Trigger, "/late")
    probe.until(lambda: late.pending, "the request")
    late.finish(False, "a fault came first")
    probe.until(future.done, "the answer")
    assert (future.result().success, future.result().message) == (False, "a fault came first")


def test_finishing_without_a_request_does_nothing_to_the_next_one(probe: Probe) -> None:
    late = DeferredTrigger(probe.node, "/late", lambda: None)
    late.finish(True, "too early")
    future = probe.begin(Trigger, "/late")
    probe.until(lambda: late.pending, "the request")
    late.finish(True, "in time")
    probe.until(future.done, "the answer")
    assert future.result().message == "in time"
