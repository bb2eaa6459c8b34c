# SPDX-License-Identifier: Apache-2.0
"""Demonstration from the page, with services whose answers are given."""

from __future__ import annotations

from pathlib import Path

import pytest

from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Answer, Code
from wam_power_ros.view import teach_again
from wam_power_ros.view.teach_again import NotTaughtError, begin, finish

PAUSE, FREE = interface.LEARNER_PAUSE, interface.GRAVITY_COMPENSATION
RECORD, LEARN = interface.RECORD, interface.LEARNER_DEMONSTRATION
BEGUN = [(PAUSE, True), (FREE, True), (RECORD, True)]


class Services:
    """Services that succeed once the given answers are used up."""

    reset = "/pancake/reset"

    def __init__(self, simulated: bool = False, **answers: list[Answer]) -> None:
        self.simulated, self.answers = simulated, answers
        self.asked: list[tuple[str, bool | None]] = []
        self.bag: Path | None = None

    def is_offered(self, name: str) -> bool:
        """Whether the demonstrator of the stand-in is available."""
        return self.simulated

    def call(self, name: str, on: bool | None = None) -> Answer:
        """Note the call, and answer."""
        self.asked.append((name, on))
        waiting = self.answers.get(name.rpartition("/")[2], [])
        return waiting.pop(0) if waiting else Answer(Code.DONE, "/bags/demo_1", {"trial": "over"})

    def publish_bag(self, bag: Path) -> None:
        """Note the bag."""
        self.bag = bag


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(teach_again, "RETRY_PERIOD", 0.001)


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(teach_again, "SERVICE_TIMEOUT", 0.01)


def test_gravity_compensation_begins_only_after_the_trial_has_ended() -> None:
    under_way = Answer(Code.DONE, "pauses after the trial under way", {"trial": "under_way"})
    services = Services(pause=[under_way] * 3)
    begin(services, lambda text: None)
    assert services.asked == [(PAUSE, True)] * 3 + BEGUN


def test_a_learner_that_is_paused_already_is_not_waited_for() -> None:
    services = Services()
    begin(services, lambda text: None)
    assert services.asked == BEGUN


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("said", [{"trial": "under_way"}, {}])  # {}: another version
def test_gravity_compensation_never_begins_if_the_trial_does_not_end(said: dict[str, str]) -> None:
    services = Services(pause=[Answer(Code.DONE, "waits", said)] * 1000)
    with pytest.raises(NotTaughtError, match="no trial ended in 0 s; the learner is paused"):
        begin(services, lambda text: None)
    assert set(services.asked) == {(PAUSE, True)}


def test_the_stand_in_demonstrates_from_the_start() -> None:
    services = Services(simulated=True)
    begin(services, lambda text: None)
    reset, lead = (Services.reset, None), (interface.DEMONSTRATE, None)
    assert services.asked == [*BEGUN[:2], reset, BEGUN[2], lead]


def test_a_person_is_notified_of_each_step() -> None:
    said: list[str] = []
    begin(Services(), said.append)
    assert said == ["/bags/demo_1", "guide the arm by hand, then press End of movement"]


def test_the_learner_learns_from_the_bag_while_the_arm_holds_and_then_continues() -> None:
    services = Services()
    assert finish(services) == "/bags/demo_1"
    assert services.asked == [(RECORD, False), (FREE, False), (LEARN, None), (PAUSE, False)]
    assert services.bag == Path("/bags/demo_1")


def test_a_learner_that_has_not_received_the_bag_yet_is_called_again() -> None:
    services = Services(demonstration=[Answer(Code.NOTHING), Answer(Code.DONE, "learnt")])
    assert finish(services) == "learnt"


def test_a_refused_demonstration_is_reported_and_the_learner_continues() -> None:
    services = Services(demonstration=[Answer(Code.REFUSED, "it never moves")])
    with pytest.raises(NotTaughtError, match="it never moves"):
        finish(services)
    assert services.asked[-1] == (PAUSE, False)


@pytest.mark.usefixtures("impatient")
def test_a_service_that_keeps_refusing_is_named() -> None:
    busy = [Answer(Code.BUSY, "a rollout is under way")] * 1000
    with pytest.raises(NotTaughtError, match=f"{FREE}: a rollout is under way"):
        begin(Services(gravity_compensation=busy), lambda text: None)


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("step", ["begin", "finish"])
def test_an_arm_that_cannot_be_recorded_holds_again(step: str) -> None:
    services = Services(record=[Answer(Code.BUSY, "the disk is full")] * 10_000)
    with pytest.raises(NotTaughtError, match="the disk is full"):
        if step == "begin":
            begin(services, lambda text: None)
        else:
            finish(services)
    assert services.asked[-1] == (FREE, False)
