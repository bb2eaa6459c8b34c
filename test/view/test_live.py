# SPDX-License-Identifier: Apache-2.0
"""Node of the page, called by a button while the session ends."""

from __future__ import annotations

import rclpy

from wam_power_ros.params import overlay
from wam_power_ros.ros import interface
from wam_power_ros.ros.outcomes import Code
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
    assert page.call(interface.RECORD, True).code is Code.NOT_ACTIVE
    assert page.teach(lambda: None, str).code is Code.NOT_ACTIVE
