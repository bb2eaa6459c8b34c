# SPDX-License-Identifier: Apache-2.0
"""Access rights: the shipped policy is compared with what the nodes use."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import rclpy
from conftest import ROOT, Processes
from layouts import uses
from rclpy.action import (
    get_action_client_names_and_types_by_node,
    get_action_server_names_and_types_by_node,
)
from rclpy.node import Node
from rights import RIGHTS

from hardware_sim.main import Simulation
from hardware_sim.optitrack_node import OptitrackSim
from wam_power_ros.client.link import Link
from wam_power_ros.client.robot import Robot
from wam_power_ros.client.rollouts import RolloutSettings
from wam_power_ros.nodes.body_tracker import BodyTracker
from wam_power_ros.nodes.demonstration_recorder import DemonstrationRecorder
from wam_power_ros.nodes.learner import Learner
from wam_power_ros.nodes.preparation_worker import PreparationWorker
from wam_power_ros.nodes.tag_camera import TagCamera
from wam_power_ros.nodes.torque_controller import TorqueController
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface, network
from wam_power_ros.ros.process_channel import pair
from wam_power_ros.view.live import View

EVERYONES = {"/rosout", "/parameter_events", "/clock"}
RELATIVE = {
    value for name, value in vars(interface).items() if name.isupper() and isinstance(value, str)
} - {interface.SCENE}
RELATIVE |= {interface.body_topic("pancake", leaf) for leaf in interface.BODY_LEAVES}
NAMES = {f"/{name.lstrip('/')}" for name in RELATIVE | {interface.rollout_topic("pancake")}}


def robot() -> Node:
    """Node of an arm as an object, of which everything is used that is no service."""
    node, settings = rclpy.create_node("robot"), RolloutSettings(**overlay.setup()["learner"])
    arm = Robot(Link(node), body="pancake", settings=settings)
    assert all((arm.scene_reset, arm.demonstrator, arm._replays, arm._rollouts))
    return node


def natnet_client() -> Node:
    pytest.importorskip("natnet")
    from wam_power_ros.nodes.natnet_client import NatNet

    return NatNet()


NODES = {
    "robot": robot,
    "torque_controller_preparation": lambda: PreparationWorker(pair()[0]),
    "torque_controller": TorqueController,
    "demonstration_recorder": DemonstrationRecorder,
    "pancake_tracker": BodyTracker,
    "tag_camera": TagCamera,
    "natnet_client": natnet_client,
    "learner": Learner,
    "wam_sim": lambda: Simulation().wam,  # offers services once its world is built
    "optitrack_sim": OptitrackSim,
    "view": lambda: View(overlay.setup()["torque_controller"], "pancake"),
}


def plain(names: list[tuple[str, list[str]]]) -> dict[str, list[str]]:
    """Names and types without those of which an action consists."""
    return {name: types for name, types in names if "/_action/" not in name}


def own(name: str, service: str) -> bool:
    """Whether a name is one that ROS gives every node, or every managed node."""
    return service.startswith(f"/{name}/") and service not in NAMES


def test_every_topic_and_service_is_somebodys_and_no_other_is() -> None:
    names = {
        (node, name)
        for node, rights in RIGHTS.items()
        for group in rights.values()
        for name in group
    }
    used = {name for _, name in names}
    assert NAMES - used == set()
    others = {name for name in used - NAMES - EVERYONES if not name.startswith("/_ros2cli")}
    assert {name for name in others if not any(own(node, name) for node in RIGHTS)} == set()


def test_only_the_controller_publishes_torques() -> None:
    torques = f"/{interface.EFFORT_COMMANDS}"
    senders = [node for node, rights in RIGHTS.items() if torques in rights["topic", "publish"]]
    assert senders == ["torque_controller"]


def franka_driver() -> Node:
    """The driver whose library is an extra; it connects later."""
    pytest.importorskip("pylibfranka")
    from wam_power_ros.nodes.franka_driver import FrankaDriver

    return FrankaDriver()


@pytest.mark.parametrize("kind", [*NODES.values(), franka_driver], ids=[*NODES, "franka_driver"])
def test_a_node_does_what_the_policy_allows_and_the_policy_allows_what_it_does(
    kind: Callable[[], Node], domain_id: int, tmp_path: Path
) -> None:
    file = tmp_path / "parameters.yaml"
    setup = overlay.setup()
    for name in ("torque_controller", "demonstration_recorder", "wam_sim"):
        setup[name]["realtime_priority"] = 0  # the node is in this process
    setup["franka_driver"].update(address="127.0.57.2", realtime_priority=0)
    file.write_text(overlay.text(setup))
    rclpy.init(args=["--ros-args", "--params-file", str(file)], domain_id=domain_id)
    try:
        node = kind()
        name = node.get_name()
        right = RIGHTS[name]
        whose = (name, node.get_namespace())
        offered = dict(get_action_server_names_and_types_by_node(node, *whose))
        used = dict(get_action_client_names_and_types_by_node(node, *whose))
        published = plain(node.get_publisher_names_and_types_by_node(*whose))
        shown = [use for use in uses() if use.topic in published]
        assert [use for use in shown if not use.fits(published[use.topic][0])] == []
        heard = plain(node.get_subscriber_names_and_types_by_node(*whose)).keys()
        served = plain(node.get_service_names_and_types_by_node(*whose)).keys()
        called = plain(node.get_client_names_and_types_by_node(*whose)).keys()
        assert published.keys() - EVERYONES == right["topic", "publish"] - EVERYONES
        assert heard - EVERYONES <= right["topic", "subscribe"]
        assert called <= right.get(("service", "request"), set())
        assert served == right["service", "reply"]
        assert offered.keys() == right.get(("action", "execute"), set())
        assert used.keys() <= right.get(("action", "call"), set())
        node.destroy_node()
    finally:
        rclpy.shutdown()


@pytest.mark.parametrize(
    ("environment", "open_"),
    [
        ({}, True),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, False),
        ({"ROS_SECURITY_ENABLE": "true"}, True),
        ({"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}, False),
    ],
)
def test_an_arm_that_anybody_can_command_is_told(environment: dict[str, str], open_: bool) -> None:
    assert (network.exposed(environment) is not None) == open_


def test_the_controller_says_so_and_with_security_enforced_never_starts_in_the_open(
    processes: Processes, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "wam_power_ros.entry", "torque_controller", "--ros-args"]
    command += ["--params-file", str(ROOT / "config/torque_controller.yaml")]
    (tmp_path / "enclaves/torque_controller").mkdir(parents=True)  # an enclave without keys
    refused = processes.start(
        [*command, "--enclave", "/torque_controller"],
        ROS_SECURITY_ENABLE="true",
        ROS_SECURITY_STRATEGY="Enforce",
        ROS_SECURITY_KEYSTORE=str(tmp_path),
    )
    assert refused.wait(120) == 2
    assert re.search("security", processes.output(refused), re.IGNORECASE)
    assert "Traceback" not in processes.output(refused)
    telling = processes.start(command, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")
    end = time.monotonic() + 60.0
    while "anybody on the network" not in processes.output(telling) and time.monotonic() < end:
        time.sleep(0.1)
    assert "anybody on the network" in processes.output(telling)
