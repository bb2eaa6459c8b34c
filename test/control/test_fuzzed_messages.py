# SPDX-License-Identifier: Apache-2.0
"""Whatever is sent to a controller, its torques are finite and within its limits."""

from __future__ import annotations

import pytest
from fuzzed_messages import bombard

from benchmark.nodes import taught
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import share
from wam_power_ros.params.torque_controller_params import TorqueControllerParams


@pytest.mark.requirement("S-01", "S-123")
def test_fuzzed_messages_give_no_torque_over_a_limit() -> None:
    files = share("config/torque_controller.yaml"), share("config/simulation.yaml")
    params = TorqueControllerParams.from_setup(overlay.from_files(files))
    controller = params.controller(share("urdf/wam7.urdf").read_text())
    found = bombard(controller, taught(), 4000, 0)
    assert found["torques"] > 3000 and found["refused"] > 50
    assert found["not finite"] == found["over"] == found["rate"] == 0
    assert controller.counters["faults"] > 1  # there was something to get wrong
