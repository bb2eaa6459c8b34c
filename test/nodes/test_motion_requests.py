# SPDX-License-Identifier: Apache-2.0
"""Requests that move the arm: one at a time, each once, and none from before a stop."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from rigid_arm import HOME, Plant, make

from wam_power_ros.control.controller import Controller
from wam_power_ros.control.joint_references import Sampled
from wam_power_ros.control.modes import Mode
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.nodes.motion_requests import MotionRequests
from wam_power_ros.ros.outcomes import Answer, Code, Ended

LATER = 10**9  # [ns]


class Answered:
    """Requests to a controller that holds an arm at the start of its policy."""

    def __init__(self) -> None:
        self.core: Controller = make()
        self.policy = self.core._policy
        self.plant = Plant(HOME)
        self.began: list[str] = []
        self.answers: list[tuple[str, Answer]] = []
        self.end: Ended | None = None  # of the last rollout
        self.requests = MotionRequests(self.core.arm.joint_names, lambda: self.core, self)
        self.run()
        self.core.hold()
        self.run(200)

    def run(self, states: int = 1) -> None:
        """Let the arm move for some states, and answer what is requested."""
        for _ in range(states):
            self.plant.step(self.core.step(*self.plant.state()))
            self.requests.answer(self.core)

    def begun(self, id: str) -> None:
        """Keep the id of a request that has begun."""
        self.began.append(id)

    def ended(self, id: str, answer: Answer, end: Ended | None = None) -> None:
        """Keep the answer to a request, and the end of a rollout."""
        self.answers.append((id, answer))
        self.end = end or self.end

    def ask(
        self, id: str, do: str = "move_to_start", sent_ns: int | None = None, known_stop: str = ""
    ) -> Code | None:
        """Code of the answer to a request, None if it has begun."""
        count, begun = len(self.answers), len(self.began)
        sent_ns = time.time_ns() + LATER if sent_ns is None else sent_ns
        self.requests.begin(id, do, self.policy, sent_ns, known_stop)
        answers = self.answers[count:]
        assert [*self.began[begun:], *(answered for answered, _ in answers)] == [id]
        return answers[0][1].code if answers else None


@pytest.fixture
def arm() -> Answered:
    return Answered()


def test_one_request_is_under_way_at_a_time_and_each_is_answered_at_its_end(arm: Answered) -> None:
    assert arm.ask("a") is None
    assert arm.ask("b") is Code.BUSY
    assert "the previous request is under way" in arm.answers[-1][1].text
    arm.run(2000)
    assert [(id, answer.code) for id, answer in arm.answers[1:]] == [("a", Code.DONE)]
    assert arm.ask("c") is None
    arm.core.hold()  # as in a change of mode, before the next state
    assert arm.ask("d") is Code.BUSY
    arm.core.stop()
    arm.requests.stop(arm.core)
    stopped = Answer(Code.STOPPED, "stopped by a person", arm.requests.last_stop)
    assert repr(arm.answers[-1]) == repr(("c", stopped))
    assert arm.ask("e") is None


@pytest.mark.requirement("S-54")
def test_nothing_begins_that_was_sent_before_a_stop_or_before_requests_expired(
    arm: Answered,
) -> None:
    before = time.time_ns()
    arm.core.stop()
    arm.requests.stop(arm.core)
    assert arm.ask("a", sent_ns=before) is Code.STOPPED
    assert arm.answers[-1][1].stop == arm.requests.last_stop
    assert arm.core.mode is Mode.HOLD
    assert arm.ask("b", sent_ns=time.time_ns()) is None
    arm.run(2000)
    before = time.time_ns()
    arm.requests.expire()
    assert arm.ask("c", sent_ns=before) is Code.STOPPED
    assert arm.answers[-1][1].stop == ""  # nobody has stopped it


def test_a_move_is_not_answered_before_the_arm_rests(arm: Answered) -> None:
    assert arm.ask("a") is None
    core = SimpleNamespace(
        mode=Mode.HOLD, at_rest=False, ready=False, latched=None, policy_id="trial-0001"
    )
    arm.requests.answer(core)
    assert not arm.answers
    core.at_rest = core.ready = True
    arm.requests.answer(core)
    assert [(id, answer.code) for id, answer in arm.answers] == [("a", Code.DONE)]


def stop(arm: Answered) -> None:
    arm.requests.stop(arm.core)
    arm.core.stop()


def fault(kind: FaultKind) -> Callable[[Answered], None]:
    return lambda arm: arm.core.fault(Fault(kind, "a sentence on a fault"))


@pytest.mark.requirement("S-128")
@pytest.mark.parametrize(
    "act, by_person",
    [
        (lambda arm: None, False),
        (stop, True),
        (fault(FaultKind.RELEASED), True),
        (fault(FaultKind.STATES_LOST), False),
    ],
)
def test_the_end_of_a_rollout_says_who_ended_it(
    arm: Answered, act: Callable[[Answered], None], by_person: bool
) -> None:
    stop(arm)  # before it
    assert arm.ask("a", "execute") is None
    act(arm)
    while (path := arm.core.take_finished()) is None:
        arm.plant.step(arm.core.step(*arm.plant.state()))
    arm.requests.rollout_ended(arm.core, path, 1)
    stopped = arm.requests.last_stop if by_person else ""
    assert arm.end is not None and arm.end.stop == arm.answers[-1][1].stop == stopped
    assert (arm.end.policy_id, arm.end.start_ns, arm.end.fault) == (path.id, 1, arm.core.latched)
    code = Code.STOPPED if by_person else Code.FAULT if arm.core.latched else Code.DONE
    assert arm.answers[-1][1].code is code


@pytest.mark.requirement("S-128")
def test_no_request_of_a_session_begins_that_does_not_know_of_the_last_stop(arm: Answered) -> None:
    arm.core.stop()
    arm.requests.stop(arm.core)
    stop = arm.requests.last_stop
    for id, known in (("a", "none"), ("b", "another")):
        assert arm.ask(id, known_stop=known) is Code.STOPPED
        assert arm.answers[-1][1].stop == stop
    assert arm.core.mode is Mode.HOLD
    assert arm.ask("c", known_stop=stop) is None  # a person has let it go on
    arm.run(2000)
    assert arm.ask("d") is None  # of a person
    again = Answered()  # a controller that was started again knows of no stop
    assert again.ask("e", known_stop=stop) is None


@pytest.mark.requirement("S-128")
def test_a_released_switch_ends_a_replay_as_a_stop_does(arm: Answered) -> None:
    movement = Sampled(np.tile(HOME, (501, 1)), *np.zeros((2, 501, 7)), 1.0, 0.002)
    arm.requests.begin("a", "replay", movement, time.time_ns() + LATER, "")
    arm.core.fault(Fault(FaultKind.RELEASED, "the enabling switch was released"))
    arm.run()
    id, answer = arm.answers[-1]
    assert (id, answer.code, answer.stop) == ("a", Code.STOPPED, arm.requests.last_stop)
