# SPDX-License-Identifier: Apache-2.0
"""Node of the page, called by a button while the session ends."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import rclpy

from wam_power_interfaces.action import ResetScene
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface
from wam_power_ros.ros.action_server import Action
from wam_power_ros.ros.outcomes import Answer, Code
from wam_power_ros.view.live import View


def test_a_button_of_a_session_that_has_ended_is_answered_and_raises_nothing(
    domain_id: int,
) -> None:
    rclpy.init(domain_id=domain_id)
    try:
        page = View(overlay.setup()["torque_controller"], "pancake")
        with page.link:
            pass
    finally:
        rclpy.shutdown()
    assert page.give("stop").code is Code.NOT_ACTIVE
    assert page.teach(lambda: None, str).code is Code.NOT_ACTIVE


@pytest.mark.parametrize("simulated", [True, False])
def test_the_stand_in_demonstrates_where_there_is_one_and_else_a_person(
    simulated: bool, domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rclpy.init(domain_id=domain_id)
    try:
        node = rclpy.create_node("stand_in")
        page = View(overlay.setup()["torque_controller"], "pancake")
        if simulated:
            Action(node, ResetScene, interface.RESET_SCENE, lambda id, goal: Answer(Code.DONE))
        found = page.count_publishers  # of the status of the action
        wait_for_end = lambda: None  # noqa: E731
        given: list[object] = []
        feedback = SimpleNamespace(teach=lambda _, wait_for_end, notify: given.append(wait_for_end))
        monkeypatch.setattr(page, "_feedback", feedback)
        with page.link as link:
            status = f"{interface.RESET_SCENE}/_action/status"
            assert link.until(lambda: found(status) == simulated, timeout=20.0)
            link.sleep(0.5)
            page.teach(wait_for_end, str)  # nobody has asked before whether there is one
        assert given == [None if simulated else wait_for_end]
    finally:
        rclpy.shutdown()
