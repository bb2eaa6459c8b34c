# SPDX-License-Identifier: Apache-2.0
"""Activation of a controller that refuses at first."""

from __future__ import annotations

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node

from wam_power_ros.client.robot import Robot
from wam_power_ros.console import activation


def test_a_controller_is_configured_and_activated_however_often_it_refuses(
    server: Node, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(activation, "REPORT_TIMEOUT", 0.1)
    asked: list[int] = []

    def change(request: ChangeState.Request, response: ChangeState.Response) -> object:
        asked.append(request.transition.id)
        response.success = len(asked) % 2 == 0
        return response

    server.create_service(ChangeState, activation.CHANGE_STATE, change)
    activation.activate(robot.link)
    configure, activate = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
    assert asked == [configure, configure, activate, activate]
