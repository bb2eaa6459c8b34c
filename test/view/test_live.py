# SPDX-License-Identifier: Apache-2.0
"""Node of the page, called by a button while the session ends."""

from __future__ import annotations

from pathlib import Path

import rclpy

from wam_power_ros.params import overlay
from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Code
from wam_power_ros.view.live import View


def test_a_button_of_a_session_that_has_ended_is_answered_and_raises_nothing(
    domain_id: int,
) -> None:
    rclpy.init(domain_id=domain_id)
    try:
        page = View(overlay.setup()["torque_controller"], "pancake")
        page.destroy_node()
        assert not page.is_offered(interface.DEMONSTRATE)
        page.publish_bag(Path("/bags/demo_1"))
        assert page.call(interface.RECORD, True).code is Code.NOT_ACTIVE
    finally:
        rclpy.shutdown()
