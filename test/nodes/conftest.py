# SPDX-License-Identifier: Apache-2.0
"""A torque controller that the tests of a module share, and nodes in the test's own process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import pytest
import rclpy
from conftest import ROOT, Probe, Processes
from played_arm import SIMULATED, ControllerHere, PlayedArm
from rclpy.node import Node
from std_srvs.srv import Trigger

from wam_power_ros.nodes.torque_controller import TorqueController
from wam_power_ros.ros import interface

T = TypeVar("T", bound=Node)


@pytest.fixture
def node_here(domain_id: int) -> Iterator[Callable[..., Node]]:
    """Makes a node in this process, whose callbacks the test calls."""
    made: list[Node] = []

    def make(
        kind: Callable[[], T], *files: str | Path, remap: Sequence[str] = (), **parameters: object
    ) -> T:
        arguments = ["--ros-args", *(w for rule in remap for w in ("-r", rule))]
        arguments += [w for file in files for w in ("--params-file", str(ROOT / "config" / file))]
        arguments += [w for item in parameters.items() for w in ("-p", "{}:={}".format(*item))]
        rclpy.init(args=arguments, domain_id=domain_id)
        made.append(node := kind())
        return node

    yield make
    for node in made:
        node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def controller_here(
    node_here: Callable[..., TorqueController],
) -> Callable[..., ControllerHere]:
    """Makes a controller in this process, in lockstep unless the test says otherwise."""

    def make(**parameters: object) -> ControllerHere:
        usual = {"realtime_priority": 0, "autostart": False, "state_timeout": 0.0}
        return ControllerHere(node_here(TorqueController, *SIMULATED, **(usual | parameters)))

    return make


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
