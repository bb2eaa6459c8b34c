# SPDX-License-Identifier: Apache-2.0
"""A demonstration during a session: the arm is free only while the learner is paused."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from wam_power_interfaces.srv import AddDemonstration
from wam_power_ros.client import feedback as feedbacks
from wam_power_ros.client.feedback import Feedback
from wam_power_ros.client.link import Data
from wam_power_ros.ros import interface
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError

PAUSE, CONTINUE = (interface.LEARNER_PAUSE, True), (interface.LEARNER_PAUSE, False)
LEARN, TAUGHT = (interface.ADD_DEMONSTRATION, "/bags/demo_1"), ("robot", "teach")
LEARNS = Answer(Code.DONE, "learns")


class Session:
    """A link to a learner, which first gives the answers to a pause, and its arm."""

    def __init__(self, *paused: Answer, learnt: Answer = LEARNS) -> None:
        self.paused, self.learnt = [*paused], learnt
        self.asked: list[tuple[str, object]] = []

    def answer(self, name: str, data: Data) -> Answer:
        """Note the request, and answer."""
        if isinstance(data, AddDemonstration.Request):
            self.asked.append((name, data.bag))
            return self.learnt
        self.asked.append((name, data.pause))
        return self.paused.pop(0) if data.pause and self.paused else Answer(Code.DONE, "paused")

    def sleep(self, seconds: float) -> None:
        """Wait for a moment, so that answers are not used up before a timeout."""
        time.sleep(min(seconds, 1e-3))

    def teach(self, wait_for_end: Callable[[], object] | None) -> Path:
        """Note that the arm is set free and guided."""
        self.asked.append(TAUGHT)
        return Path("/bags/demo_1")


def teach(session: Session, notify: Callable[[str], object] = lambda text: None) -> Answer:
    return Feedback(session).teach(session, None, notify)


def test_the_arm_is_free_after_the_trial_has_ended_and_the_learner_learns_and_continues() -> None:
    said: list[str] = []
    session = Session(*[Answer(Code.DONE, "pauses after the trial", under_way=True)] * 3)
    assert teach(session, said.append) is LEARNS
    assert said == ["pauses after the trial"]
    assert session.asked == [*[PAUSE] * 4, TAUGHT, LEARN, CONTINUE]


def test_the_arm_is_never_free_if_the_trial_does_not_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feedbacks, "TIMEOUT", 0.01)
    session = Session(*[Answer(Code.DONE, "waits", under_way=True)] * 10_000)
    with pytest.raises(ServiceError, match="no trial ended in 0 s; the learner is paused"):
        teach(session)
    assert set(session.asked) == {PAUSE}


def test_a_refused_demonstration_is_reported_and_the_learner_continues() -> None:
    session = Session(learnt=Answer(Code.REFUSED, "it never moves"))
    assert teach(session) == Answer(Code.REFUSED, "it never moves")
    assert session.asked[-1] == CONTINUE
