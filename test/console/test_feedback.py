# SPDX-License-Identifier: Apache-2.0
"""Feedback of a person: one request and one answer for every kind."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.cli import main
from wam_power_ros.client.feedback import SERVICES
from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Answer, Code

if TYPE_CHECKING:
    from conftest import Probe


def test_every_kind_of_feedback_can_be_given_on_the_command_line() -> None:
    for kind in (*SERVICES, "demonstration"):
        assert main._parser().parse_args(["feedback", kind]).kind == kind
    with pytest.raises(SystemExit):
        main._parser().parse_args(["feedback", "applause"])


def test_the_answer_of_the_learner_is_returned_and_a_pause_is_not_a_continuation(
    probe: Probe, domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[bool] = []

    def pause(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        asked.append(request.data)
        response.success, response.message = True, str(Answer(Code.DONE, "paused"))
        return response

    def reward(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = False
        response.message = str(Answer(Code.NOTHING, "no rollout has finished"))
        return response

    probe.node.create_service(SetBool, interface.LEARNER_PAUSE, pause)
    probe.node.create_service(Trigger, interface.LEARNER_REWARD, reward)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    for kind, expected in (
        ("pause", "(True, 'paused')"),
        ("continue", "(True, 'paused')"),
        ("reward", "(False, 'no rollout has finished')"),
    ):
        code = f"from wam_power_ros.console.feedback import give; a = give({kind!r}); "
        code += "print((a.success, a.text))"
        given = subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        probe.until(lambda given=given: given.poll() is not None, f"an answer to {kind}", 60.0)
        output, errors = given.communicate()
        assert output.strip() == expected, errors
    assert asked == [True, False]
