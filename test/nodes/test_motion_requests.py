# SPDX-License-Identifier: Apache-2.0
"""Requests that move the arm: one at a time, each once, and none from before a stop."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest
from rigid_arm import HOME, Plant, make

from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import Mode
from wam_power_ros.nodes.motion_requests import MotionRequests
from wam_power_ros.ros.answers import Answer, Code

LATER = 10**9  # [ns]


class Answered:
    """Requests to a controller that holds an arm at the start of its policy."""

    def __init__(self) -> None:
        self.core: Controller = make()
        self.policy = self.core._rollouts.policy
        self.plant = Plant(HOME)
        self.answers: list[tuple[str, Answer]] = []
        self.requests = MotionRequests(
            self.core.arm.joint_names,
            lambda: self.core,
            lambda id, answer: self.answers.append((id, answer)),
        )
        self.run()
        self.core.hold()
        self.run(200)

    def run(self, states: int = 1) -> None:
        """Let the arm move for some states, and answer what is requested."""
        for _ in range(states):
            self.plant.step(self.core.step(*self.plant.state()))
            self.requests.answer(self.core)

    def ask(self, id: str, do: str = "move_to_start", sent_ns: int | None = None) -> Code:
        """Code of the first answer to a request."""
        count = len(self.answers)
        sent_ns = time.time_ns() + LATER if sent_ns is None else sent_ns
        self.requests.begin(id, do, self.policy, sent_ns)
        (answered, answer), *_ = self.answers[count:]
        assert answered == id
        return answer.code


@pytest.fixture
def arm() -> Answered:
    return Answered()


def test_one_request_is_under_way_at_a_time_and_each_is_answered_at_its_end(arm: Answered) -> None:
    assert arm.ask("a") is Code.BEGUN
    assert arm.ask("b") is Code.BUSY
    arm.run(2000)
    assert [(id, answer.code) for id, answer in arm.answers[2:]] == [("a", Code.DONE)]
    assert arm.ask("c") is Code.BEGUN


def test_a_request_that_comes_again_is_answered_as_before_and_begins_nothing(
    arm: Answered,
) -> None:
    assert arm.ask("a", "execute") is Code.BEGUN
    assert arm.ask("a", "execute") is Code.BEGUN  # its answer was not heard
    arm.core.stop()
    arm.run(200)
    assert arm.ask("a", "execute") is Code.STOPPED
    assert arm.core.mode is Mode.HOLD


@pytest.mark.requirement("S-54")
def test_nothing_begins_that_was_sent_before_a_stop_or_before_requests_expired(
    arm: Answered,
) -> None:
    before = time.time_ns()
    arm.core.stop()
    arm.requests.stop(arm.core)
    assert arm.ask("a", sent_ns=before) is Code.STOPPED
    assert arm.core.mode is Mode.HOLD
    assert arm.ask("b", sent_ns=time.time_ns()) is Code.BEGUN
    arm.run(2000)
    before = time.time_ns()
    arm.requests.expire()
    assert arm.ask("c", sent_ns=before) is Code.STOPPED


def test_a_stop_ends_the_request_under_way(arm: Answered) -> None:
    assert arm.ask("a") is Code.BEGUN
    arm.core.stop()
    arm.requests.stop(arm.core)
    assert arm.answers[-1] == ("a", Answer(Code.STOPPED, "stopped"))
    assert arm.requests._id == ""


def test_a_request_is_busy_until_the_one_before_has_been_answered(arm: Answered) -> None:
    assert arm.ask("a") is Code.BEGUN
    arm.core.hold()  # as in a change of mode, before the next state
    assert arm.ask("b") is Code.BUSY
    assert "the previous request is under way" in arm.answers[-1][1].text
    arm.run()
    assert [id for id, answer in arm.answers if answer.code is not Code.BEGUN] == ["b", "a"]


def test_a_move_is_not_answered_before_the_arm_rests(arm: Answered) -> None:
    assert arm.ask("a") is Code.BEGUN
    core = SimpleNamespace(
        mode=Mode.HOLD, at_rest=False, ready=False, latched=None, policy_id="trial-0001"
    )
    arm.requests.answer(core)
    assert len(arm.answers) == 1
    core.at_rest = core.ready = True
    arm.requests.answer(core)
    assert arm.answers[1:] == [("a", Answer(Code.DONE, values={"policy": "trial-0001"}))]
