# SPDX-License-Identifier: Apache-2.0
"""Two publishers of joint states, and states that are refused: the controller says so."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import rclpy
from lifecycle_msgs.msg import Transition
from played_arm import GRAVITY, HOME, NAMES, ControllerHere, PlayedArm, numbered
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from wam_power_ros.faults import FaultKind
from wam_power_ros.ros import interface
from wam_power_ros.ros.simulation_guard import STAND_IN
from wam_power_ros.ros.stamps import time_message

ANOTHER = 60_000  # number of a message of another publisher


@pytest.mark.requirement("S-130")
def test_a_second_publisher_of_our_joints_keeps_us_from_starting_and_is_named(
    controller_here: Callable[..., ControllerHere],
) -> None:
    arm = controller_here()
    assert arm.configure()
    arm.send()
    arm.send(number=ANOTHER)
    assert not arm.activate()
    text = "more than one publisher sends states of these joints on /joint_states"
    assert arm.refused[-1].startswith(f"activation refused: {text}")


@pytest.mark.requirement("S-130")
def test_a_second_publisher_that_appears_is_a_fault_and_its_states_are_not_used(
    arm: PlayedArm,
) -> None:
    # Announced before: a name that is discovered late would deactivate an active controller.
    probe = arm.probe
    assert probe.change(Transition.TRANSITION_DEACTIVATE)
    node = rclpy.create_node(STAND_IN, namespace="appears", context=probe.context)
    zeros = node.create_publisher(JointState, "/joint_states", interface.STATE_OUT)
    probe.until(lambda: zeros.get_subscription_count() > 0, "the controller")

    def say() -> None:
        arm.stamp_ns += 1
        message = JointState(name=NAMES, position=[0.0] * 7, velocity=[0.0] * 7)
        message.header.stamp = time_message(arm.stamp_ns)
        zeros.publish(message)

    activate = Transition.TRANSITION_ACTIVATE
    probe.until(lambda: arm.send() or probe.change(activate), "the activation")
    arm.settle()
    count = len(arm.read())
    for _ in range(100):
        arm.send()
        arm.answer()
        say()
    labels = [torque.label for torque in arm.read()[count:]]
    assert "fault" in labels[:5] and labels[-1] == "fault"
    for torque in arm.torques[count:]:
        np.testing.assert_allclose(torque.tau, GRAVITY, rtol=0.0, atol=0.1)
    report = arm.diagnosis(lambda d: d["mode"] == "fault", "the fault")
    assert report["fault kind"] == FaultKind.SECOND_PUBLISHER.value
    assert f"/appears/{STAND_IN}" in report["message"]

    say()
    arm.send()
    arm.answer()
    refused = probe.call(Trigger, interface.RESET)
    assert not refused.success and f"/appears/{STAND_IN}" in refused.message
    arm.reset()  # once it sends nothing any more
    node.destroy_node()


@pytest.mark.requirement("S-130")
def test_a_publisher_of_other_joints_is_legal_and_a_second_one_of_velocities_a_fault(
    controller_here: Callable[..., ControllerHere],
) -> None:
    arm = controller_here(velocity_topic="/velocities")
    still = JointState(name=NAMES, velocity=[0.0] * 7)
    assert arm.configure()
    arm.node._on_velocity(still, numbered(1))
    arm.send()
    assert arm.activate()
    arm.send(["finger"], HOME[:1], number=ANOTHER)
    assert arm.send() == "hold"
    arm.node._on_velocity(still, numbered(ANOTHER))
    assert arm.send() == "fault"
    assert arm.node._controller.latched.kind is FaultKind.SECOND_PUBLISHER


@pytest.mark.requirement("S-11")
def test_states_that_arrive_but_are_refused_are_not_said_to_be_missing(
    controller_here: Callable[..., ControllerHere],
) -> None:
    arm = controller_here()
    assert arm.configure()
    for names, q, reason in (
        (NAMES, np.rad2deg(HOME), "position of joint 4 is 115, allowed is 20 rad: degrees?"),
        (NAMES[:6], HOME[:6], "joints ['wam_j7'] missing in names"),
    ):
        arm.node._watchdog.arrived_ns = 0
        arm.send(names, q)
        arm.node._watchdog.arrived_ns = 0
        assert not arm.activate()
        said = "activation refused: joint states arrive, but are refused: "
        assert arm.refused[-1].startswith(f"{said}{reason}")
