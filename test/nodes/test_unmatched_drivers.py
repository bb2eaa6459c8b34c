# SPDX-License-Identifier: Apache-2.0
"""A driver of other types over real DDS: the controller names both sides."""

from __future__ import annotations

from collections.abc import Callable

import rclpy
from conftest import Probe, Processes, diagnosis
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from played_arm import MODULE, NAMES, SIMULATED
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from wam_power_ros.ros import interface, joint_messages


def test_the_controller_names_states_description_and_commands_that_do_not_match(
    probe: Probe, processes: Processes, domain_id: int
) -> None:
    reports = probe.listen(DiagnosticArray, interface.DIAGNOSTICS, interface.DIAGNOSTICS_QOS)
    context = rclpy.Context()  # a participant: one cannot have two types on a topic
    rclpy.init(context=context, domain_id=domain_id)
    arm = rclpy.create_node("arm_driver", context=context)
    arm.create_publisher(Float64MultiArray, "/joint_states", 10)
    arm.create_publisher(String, "/robot_description", 1)
    arm.create_subscription(JointState, "/effort_controller/commands", lambda _: None, 1)
    given = {"realtime_priority": 0, "autostart": False, "simulation": False, "urdf": "''"}
    controller = processes.node(MODULE, *SIMULATED, **given)

    def change(transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(probe.call(ChangeState, "/torque_controller/change_state", request).success)

    def refused(transition: int, *parts: str, before: Callable[[], None] = lambda: None) -> bool:
        before()
        assert not change(transition)
        probe.spin(0.1)
        newest = diagnosis(reports, "torque_controller").get("last refusal", "")
        return all(part in newest for part in parts)

    # At the first attempts the driver may not have been discovered
    configure, activate = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
    said = "node 'arm_driver' publishes std_msgs/msg/String (reliable, volatile)", "not std_msgs"
    probe.until(lambda: refused(configure, *said), str(said))
    processes.end(controller)

    processes.node(MODULE, *SIMULATED, **(given | {"urdf": "urdf/wam7.urdf"}))
    assert change(configure)
    said = "publishes std_msgs/msg/Float64MultiArray", "not sensor_msgs/msg/JointState (at least"
    probe.until(lambda: refused(activate, *said), str(said))

    # Another driver of its states, later; the torques still reach nobody
    states = probe.publisher(JointState, "/joint_states", interface.STATE_OUT)
    write, sent = joint_messages.JointStateWriter(NAMES), [1_700_000_000_000_000_000]

    def state() -> None:
        sent[0] += 2_000_000
        states.publish(write(sent[0], [0.0] * 7, [0.0] * 7, [0.0] * 7))

    text = "'arm_driver' subscribes to /effort_controller/commands as sensor_msgs/msg/JointState"
    probe.until(lambda: refused(activate, text, before=state), text)
    rclpy.shutdown(context=context)
