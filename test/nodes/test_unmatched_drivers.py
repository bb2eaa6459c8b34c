# SPDX-License-Identifier: Apache-2.0
"""Drivers of another type or QoS over real DDS: every node names both sides."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator

import pytest
import rclpy
from conftest import Probe, Processes, diagnosis
from geometry_msgs.msg import PointStamped, PoseStamped
from lifecycle_msgs.msg import Transition
from played_arm import NAMES
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.stamps import time_message

CONTROLLER = "wam_power_ros.nodes.torque_controller"
TRACKER = "wam_power_ros.nodes.body_tracker"
RECORDER = "wam_power_ros.nodes.demonstration_recorder"
MOCAP = (
    "node 'mocap_driver' publishes geometry_msgs/msg/PointStamped (reliable, volatile) on "
    "/pancake/pose, not geometry_msgs/msg/PoseStamped"
)


@pytest.fixture
def driver(domain_id: int) -> Iterator[Callable[[str], Node]]:
    """Makes driver nodes, each a participant: one cannot have two types on a topic."""
    made: list[Node] = []

    def make(name: str) -> Node:
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain_id)
        made.append(rclpy.create_node(name, context=context))
        return made[-1]

    yield make
    for node in made:
        rclpy.shutdown(context=node.context)


def test_a_mocap_driver_of_another_type_is_named_by_tracker_recorder_and_check(
    probe: Probe, processes: Processes, driver: Callable[[str], Node]
) -> None:
    reports = probe.diagnostics()
    driver("mocap_driver").create_publisher(PointStamped, "/pancake/pose", 10)
    words = ["run", "check_driver", "--seconds", "0.5", "--config", "natnet_ros2"]
    check = processes.start([sys.executable, "-m", "wam_power_ros.cli", *words])
    tracker = processes.node(TRACKER, "pancake_tracker.yaml")
    recorder = processes.node(RECORDER, "demonstration_recorder.yaml")

    def named(node: str, level: str) -> bool:
        found = diagnosis(reports, node)
        return MOCAP in found.get("message", "") and found["level"] == level

    probe.until(lambda: named("pancake_tracker", "2"), "the tracker's diagnostics")
    probe.until(lambda: named("demonstration_recorder", "1"), "the recorder's diagnostics")
    assert "not recorded: " in diagnosis(reports, "demonstration_recorder")["message"]
    for process in (tracker, recorder):
        assert MOCAP in processes.output(process)
    probe.until(lambda: check.poll() is not None, "the end of the check")
    said = " ".join(processes.output(check).replace("│", " ").split())
    assert check.returncode == 1 and "DOES NOT CONFORM" in said, said
    for part in ("geometry_msgs/msg/PointStamped", "geometry_msgs/msg/PoseStamped"):
        assert part in said.replace("- ", "-")

    # A driver that starts later and is received: a warning remains about the first.
    poses = probe.publisher(PoseStamped, "/pancake/pose", interface.STATE_OUT)
    for _ in range(3):
        message = PoseStamped()
        message.header.stamp = probe.node.get_clock().now().to_msg()
        message.pose.position.x, message.pose.orientation.w = 0.6, 1.0
        poses.publish(message)
        probe.spin(0.03)
    probe.until(lambda: "first frame received" in processes.output(tracker), "a frame")
    reports.clear()
    probe.until(lambda: MOCAP in diagnosis(reports, "pancake_tracker").get("message", ""), "it")


def test_the_controller_names_states_description_and_commands_that_do_not_match(
    probe: Probe, processes: Processes, driver: Callable[[str], Node]
) -> None:
    reports = probe.diagnostics()
    arm = driver("arm_driver")
    arm.create_publisher(Float64MultiArray, "/joint_states", 10)
    arm.create_publisher(String, "/robot_description", 1)
    arm.create_subscription(JointState, "/effort_controller/commands", lambda _: None, 1)
    given = {"realtime_priority": 0, "autostart": False, "simulation": False, "urdf": "''"}
    files = ("torque_controller.yaml", "simulation.yaml")
    controller = processes.node(CONTROLLER, *files, **given)

    def refusal(*parts: str) -> str:
        newest = lambda: diagnosis(reports, "torque_controller").get("last refusal", "")  # noqa: E731
        return str(probe.until(lambda: all(p in newest() for p in parts) and newest(), str(parts)))

    assert not probe.change(Transition.TRANSITION_CONFIGURE)
    refusal("node 'arm_driver' publishes std_msgs/msg/String (reliable, volatile)", "not std_msgs")
    processes.end(controller)

    processes.node(CONTROLLER, *files, **(given | {"urdf": "urdf/wam7.urdf"}))
    assert probe.change(Transition.TRANSITION_CONFIGURE)

    def refused(*parts: str, before: Callable[[], None] = lambda: None) -> bool:
        before()
        assert not probe.change(Transition.TRANSITION_ACTIVATE)
        newest = diagnosis(reports, "torque_controller").get("last refusal", "")
        return all(part in newest for part in parts)

    # At the first attempts the driver may not have been discovered
    parts = "publishes std_msgs/msg/Float64MultiArray", "not sensor_msgs/msg/JointState (at least"
    probe.until(lambda: refused(*parts), str(parts))

    # Another driver of its states, later; the torques still reach nobody
    states = probe.publisher(JointState, "/joint_states", interface.STATE_OUT)
    write, sent = joint_messages.JointStateWriter(NAMES), [0]

    def state() -> None:
        sent[0] += 2_000_000
        message = write(1_700_000_000_000_000_000 + sent[0], [0.0] * 7, [0.0] * 7, [0.0] * 7)
        message.header.stamp = time_message(1_700_000_000_000_000_000 + sent[0])
        states.publish(message)

    text = "'arm_driver' subscribes to /effort_controller/commands as sensor_msgs/msg/JointState"
    probe.until(lambda: refused(text, before=state), text)
