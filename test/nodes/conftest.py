# SPDX-License-Identifier: Apache-2.0
"""A torque controller that the tests of a module share."""

from __future__ import annotations

import pytest
from conftest import Probe, Processes
from played_arm import PlayedArm
from std_srvs.srv import Trigger

from wam_power_ros.ros import interface


@pytest.fixture(scope="module")
def activated(shared_nodes: tuple[Probe, Processes]) -> PlayedArm:
    """The controller, active."""
    arm = PlayedArm(*shared_nodes)
    arm.activate()
    return arm


@pytest.fixture
def arm(activated: PlayedArm) -> PlayedArm:
    """The controller, which holds an arm at rest, whatever the test before has left."""
    activated.settle()
    if activated.read()[-1].label == "fault":
        activated.reset()
        activated.settle()
    if activated.read()[-1].label != "hold":
        assert activated.probe.call(Trigger, interface.STOP).success
        activated.settle()
    assert activated.read()[-1].label == "hold"
    activated.diagnostics.clear()
    return activated
