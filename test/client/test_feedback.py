# SPDX-License-Identifier: Apache-2.0
"""Feedback to a learner and a demonstration during its session; the answers are given."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace

import pytest

from wam_power_interfaces.srv import AddDemonstration
from wam_power_ros.client import feedback as feedbacks
from wam_power_ros.client import link as links
from wam_power_ros.client import robot as robots
from wam_power_ros.client.feedback import Feedback
from wam_power_ros.client.link import Data
from wam_power_ros.client.robot import Robot
from wam_power_ros.ros import interface
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError

PAUSE, FREE = interface.LEARNER_PAUSE, interface.GRAVITY_COMPENSATION
RECORD, LEARN = interface.RECORD, interface.ADD_DEMONSTRATION
RESET, LEAD = interface.RESET_SCENE, interface.DEMONSTRATE
BEFORE, AFTER = [(PAUSE, True), (FREE, True)], [(RECORD, False), (FREE, False)]
GIVEN = [(LEARN, None), (PAUSE, False)]


class Services:
    """A link to services that succeed once the given answers are used up."""

    insist, answer = links.Link.insist, links.Link.answer

    def __init__(self, **answers: list[Answer]) -> None:
        self.answers, self.bags = answers, []
        self.asked: list[tuple[str, bool | None]] = []
        recorder = SimpleNamespace(node_name="demonstration_recorder")
        self.node = SimpleNamespace(
            get_subscriptions_info_by_topic=lambda _: [recorder],
        )

    def call(self, name: str, data: Data = None, timeout: float = 0.0) -> Answer:
        """Note the call, and answer."""
        if isinstance(data, AddDemonstration.Request):
            self.bags.append(data.bag)
            data = None
        self.asked.append((name, getattr(data, "pause", data)))
        waiting = self.answers.get(name.rpartition("/")[2], [])
        return waiting.pop(0) if waiting else Answer(Code.DONE, "/bags/demo_1")

    def until(self, condition: Callable[[], object], what: str) -> bool:
        """Whether the condition holds already."""
        return bool(condition())

    def sleep(self, seconds: float) -> None:
        """Wait for a moment, so that answers are not used up before a timeout."""
        time.sleep(min(seconds, 1e-3))

    def _full(self, name: str) -> str:
        return name


class Action:
    """Client of an action whose goals are done at once."""

    def __init__(self, services: Services, kind: type, name: str) -> None:
        self._services, self._name = services, name

    def send(self) -> Action:
        """Note the goal."""
        self._services.call(self._name)
        return self

    def done(self, timeout: float = 0.0) -> None:
        """Do nothing."""


@pytest.fixture(autouse=True)
def given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robots, "Action", Action)


def teach(
    services: Services,
    lead: Callable[[], object] | None = lambda: None,
    notify: Callable[[str], object] = lambda text: None,
) -> Answer:
    return Feedback(services).teach(Robot(services, body="pancake"), lead, notify)


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (feedbacks, links):
        monkeypatch.setattr(module, "TIMEOUT", 0.01)


def test_a_person_leads_after_the_trial_has_ended_and_the_learner_learns_while_the_arm_holds() -> (
    None
):
    said: list[str] = []
    services = Services(pause=[Answer(Code.DONE, "pauses after the trial", under_way=True)] * 3)
    teach(services, lambda: services.asked.append(("hand", None)), said.append)
    assert said == ["pauses after the trial"] and services.bags == ["/bags/demo_1"]
    led = [*BEFORE, (RECORD, True), ("hand", None), *AFTER, *GIVEN]
    assert services.asked == [(PAUSE, True)] * 3 + led


@pytest.mark.usefixtures("impatient")
def test_gravity_compensation_never_begins_if_the_trial_does_not_end() -> None:
    services = Services(pause=[Answer(Code.DONE, "waits", under_way=True)] * 10_000)
    with pytest.raises(ServiceError, match="no trial ended in 0 s; the learner is paused"):
        teach(services)
    assert set(services.asked) == {(PAUSE, True)}


def test_the_stand_in_demonstrates_from_the_start() -> None:
    services = Services()
    teach(services, lead=None)
    simulated = [(RESET, None), (RECORD, True), (LEAD, None)]
    assert services.asked == [*BEFORE, *simulated, *AFTER, *GIVEN]


def test_a_refused_demonstration_is_reported_and_the_learner_continues() -> None:
    services = Services(add_demonstration=[Answer(Code.REFUSED, "it never moves")])
    assert teach(services) == Answer(Code.REFUSED, "it never moves")
    assert services.asked[-1] == (PAUSE, False)


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("begun", [False, True])
def test_an_arm_that_cannot_be_recorded_holds_again(begun: bool) -> None:
    begin = [Answer(Code.DONE, "/bags/demo_1")] * begun
    services = Services(record=[*begin, *[Answer(Code.BUSY, "the disk is full")] * 10_000])
    with pytest.raises(ServiceError, match="the disk is full"):
        teach(services)
    assert services.asked[-1] == (FREE, False)
