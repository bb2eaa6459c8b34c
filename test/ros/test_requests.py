# SPDX-License-Identifier: Apache-2.0
"""Requests and their answers as messages, and a node that takes requests."""

from __future__ import annotations

import json

import pytest
from conftest import Probe
from std_msgs.msg import String

from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.ros import requests
from wam_power_ros.ros.outcomes import Answer, Code
from wam_power_ros.ros.requests import Request, RolloutEnd, Server


def test_a_request_and_an_answer_are_read_as_they_were_written() -> None:
    asked = Request("execute", {"policy": '{"id": "trial-0001"}'})
    assert requests.request(asked.message().data) == asked
    assert Request("execute").id != Request("execute").id
    answer = Answer(Code.FAULT, "a [text] of any kind", {"policy": "a name with spaces"})
    assert requests.read_answer(requests.answer_message("7", answer)) == ("7", answer)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "a request"),
        ("[]", "JSON object of texts"),
        ('{"id": 7, "do": "execute"}', "JSON object of texts"),
        ('{"do": "execute"}', "must have \\['id'\\]"),
        ('{"id": "", "do": "execute"}', "1 to 100 characters"),
        (json.dumps({"id": "x" * 101, "do": "execute"}), "1 to 100 characters"),
    ],
)
def test_what_is_no_request_is_refused(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        requests.request(text)


@pytest.mark.parametrize("text", ["[]", '{"id": "7"}', '{"id": "7", "code": "luck", "text": ""}'])
def test_what_is_no_answer_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"answer|luck"):
        requests.read_answer(String(data=text))


@pytest.mark.parametrize("fault", [None, Fault(FaultKind.TOOL_SPEED, "2.1 m/s")])
def test_the_end_of_a_rollout_keeps_its_id_start_fault_and_region(fault: Fault | None) -> None:
    end = RolloutEnd("trial-0001", 1_795_640_661_883_907_267, fault, "the obstacle")
    assert RolloutEnd.of(end.answer()) == end
    with pytest.raises(ValueError, match="not about the end of a rollout"):
        RolloutEnd.of(Answer(Code.DONE, values={"policy": "trial-0001"}))


def test_a_server_answers_each_request_once_and_one_of_a_kind_at_a_time(probe: Probe) -> None:
    def refuse(asked: Request) -> Answer:
        raise ValueError(f"no {asked.about['bag']}")

    begin = {"move": lambda _: None, "add": refuse}
    server = Server(probe.node, "/scene/request", "/scene/answer", begin)

    def ask(do: str, **about: str) -> list[Answer]:
        answers = probe.ask(do, to="SCENE", **about)
        probe.until(lambda: answers, "an answer")
        return answers

    moved = ask("move")
    assert moved == [Answer(Code.BEGUN)]
    assert ask("move")[0].code is Code.BUSY
    assert ask("add", bag="demo_1") == [Answer(Code.REFUSED, "no demo_1")]
    assert "must be one of ['add', 'move']" in ask("wave")[0].text
    server.finish("move", Answer(Code.DONE))
    probe.until(lambda: moved[1:], "the end")
    assert moved[1] == Answer(Code.DONE) and server.pending == {}


def test_a_request_that_comes_again_is_answered_as_before(probe: Probe) -> None:
    begun: list[str] = []
    begin = {"count": lambda asked: begun.append(asked.id) or Answer(Code.DONE, str(len(begun)))}
    Server(probe.node, "/scene/request", "/scene/answer", begin)
    request = Request("count")
    for number in (1, 2):
        answers = probe.send(String, "SCENE_REQUEST", request.message(), request.id, "SCENE")
        probe.until(lambda: len(answers) == number, "an answer")  # noqa: B023
    assert begun == [request.id] and answers[0] == answers[1]
