# SPDX-License-Identifier: Apache-2.0
"""Two publishers of joint states, and states that are refused, over DDS: the controller says so."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import rclpy
from conftest import Probe, Processes, diagnosis
from lifecycle_msgs.msg import Transition
from played_arm import GRAVITY, HOME, NAMES, PlayedArm
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from wam_power_ros.faults import FaultKind
from wam_power_ros.ros import interface
from wam_power_ros.ros.guards import STAND_IN
from wam_power_ros.ros.stamps import time_message

ZEROS = np.zeros(7)


class Lab:
    """The played arm as a driver, and other publishers of joint states beside it."""

    def __init__(self, probe: Probe, processes: Processes, **given: object) -> None:
        self.probe, self.arm = probe, PlayedArm(probe, processes, autostart=False, **given)
        self.change(Transition.TRANSITION_CONFIGURE)

    def change(self, transition: int) -> bool:
        """Whether a transition of the controller succeeds."""
        return self.probe.change(transition)

    def activated(self, beside: Callable[[], None] = lambda: None) -> bool:
        """Whether an attempt to activate the controller succeeds after some states."""
        for _ in range(5):
            self.arm.send()
            beside()
            self.probe.spin(0.002)
        return self.change(Transition.TRANSITION_ACTIVATE)

    def activate(self) -> None:
        """Activate the controller, and hold."""
        self.probe.until(self.activated, "the activation")
        self.arm.settle()
        assert self.arm.read()[-1].label == "hold"

    def other(self, namespace: str, topic: str = "/joint_states") -> Publisher:
        """Another publisher of joint states: a simulation answers nodes of this name only."""
        node = rclpy.create_node(STAND_IN, namespace=namespace, context=self.probe.context)
        publisher = node.create_publisher(JointState, topic, interface.STATE_OUT)
        self.probe.until(lambda: publisher.get_subscription_count() > 0, "the controller")
        self.probe.spin(0.1)  # a reader that has not matched us yet loses what we send
        return publisher

    def say(self, publisher: Publisher, names: list[str], q: np.ndarray) -> None:
        """Publish a state of another, with the present stamp of the driver."""
        self.arm.stamp_ns += 1
        message = JointState(name=names, position=list(q), velocity=[0.0] * len(q))
        message.header.stamp = time_message(self.arm.stamp_ns)
        publisher.publish(message)

    def refusal(self, *parts: str) -> str:
        """The last refusal in the diagnostics, once it has these parts."""
        newest = lambda: diagnosis(self.arm.diagnostics, "torque_controller").get("last refusal")  # noqa: E731
        said = lambda: all(part in (newest() or "") for part in parts) and newest()  # noqa: E731
        return str(self.probe.until(said, str(parts)))


@pytest.fixture(scope="module")
def configured(shared_nodes: tuple[Probe, Processes]) -> Lab:
    """A controller that several tests share."""
    return Lab(*shared_nodes)


@pytest.fixture
def lab(configured: Lab) -> Lab:
    """The shared controller, which is not active."""
    if configured.arm.read() and configured.arm.read()[-1].label != "inactive":
        assert configured.change(Transition.TRANSITION_DEACTIVATE)
    configured.arm.diagnostics.clear()
    return configured


@pytest.mark.requirement("S-130")
def test_a_second_publisher_of_our_joints_keeps_us_from_starting_and_is_named(lab: Lab) -> None:
    zeros = lab.other("zeros")
    for _ in range(5):
        assert not lab.activated(lambda: lab.say(zeros, NAMES, ZEROS))
    text = "more than one publisher sends states of these joints on /joint_states"
    assert f"{text}: /{STAND_IN}, /zeros/{STAND_IN}" in lab.refusal("activation", text)
    lab.activate()  # it is still announced, but sends nothing any more


@pytest.mark.requirement("S-130")
def test_a_second_publisher_that_appears_is_a_fault_and_its_states_are_not_used(lab: Lab) -> None:
    # Announced before: a name that is discovered late would deactivate an active controller.
    arm, zeros = lab.arm, lab.other("appears")
    lab.activate()
    count = len(arm.read())
    for _ in range(100):
        arm.send()
        arm.answer()
        lab.say(zeros, NAMES, ZEROS)
    labels = [torque.label for torque in arm.read()[count:]]
    assert "fault" in labels[:5] and labels[-1] == "fault"
    for torque in arm.torques[count:]:
        np.testing.assert_allclose(torque.tau, GRAVITY, rtol=0.0, atol=0.1)
    report = arm.diagnosis(lambda d: d["mode"] == "fault", "the fault")
    assert report["fault kind"] == FaultKind.SECOND_PUBLISHER.value
    assert f"/appears/{STAND_IN}" in report["message"]

    lab.say(zeros, NAMES, ZEROS)
    arm.send()
    arm.answer()
    refused = lab.probe.call(Trigger, interface.RESET)
    assert not refused.success and f"/appears/{STAND_IN}" in refused.message
    arm.reset()  # once it sends nothing any more


@pytest.mark.requirement("S-130")
def test_publishers_of_other_joints_and_a_driver_that_was_restarted_are_legal(lab: Lab) -> None:
    hand = lab.other("hand")
    lab.probe.until(lambda: lab.activated(lambda: lab.say(hand, ["finger"], ZEROS[:1])), "it")
    for _ in range(100):
        lab.say(hand, ["finger"], ZEROS[:1])
        lab.arm.send()
        assert lab.arm.answer().label == "hold"
    lab.change(Transition.TRANSITION_DEACTIVATE)
    lab.arm._publisher = lab.other("restarted")  # the old one stays announced
    lab.activate()


@pytest.mark.requirement("S-130")
def test_a_second_publisher_of_velocities_is_a_fault(probe: Probe, processes: Processes) -> None:
    lab = Lab(probe, processes, velocity_topic="/velocities")
    driver, other = (lab.other(namespace, "/velocities") for namespace in ("arm", "filter"))
    still = JointState(name=NAMES, velocity=[0.0] * 7)
    probe.until(lambda: lab.activated(lambda: driver.publish(still)), "the activation")

    def ended() -> bool:
        for publisher in (driver, driver, other):
            publisher.publish(still)
            lab.arm.send(qd=np.empty(0))
            lab.arm.answer()
        return lab.arm.torques[-1].label == "fault"

    probe.until(ended, "the fault")
    report = lab.arm.diagnosis(lambda d: d["mode"] == "fault", "it")
    assert report["fault kind"] == FaultKind.SECOND_PUBLISHER.value
    assert f"on /velocities: /arm/{STAND_IN}, /filter/{STAND_IN}" in report["message"]


@pytest.mark.requirement("S-11")
def test_states_that_arrive_but_are_refused_are_not_said_to_be_missing(
    probe: Probe, processes: Processes
) -> None:
    lab = Lab(probe, processes)
    for names, q, reason in (
        (NAMES, np.rad2deg(HOME), "position of joint 4 is 115, allowed is 20 rad: degrees?"),
        (NAMES[:6], HOME[:6], "joints ['wam_j7'] missing in names"),
    ):
        lab.arm.diagnostics.clear()

        def refused() -> bool:
            lab.arm.send(names, q)  # noqa: B023
            assert not lab.change(Transition.TRANSITION_ACTIVATE)
            said = diagnosis(lab.arm.diagnostics, "torque_controller").get("message", "")
            return reason in said  # noqa: B023

        probe.until(refused, reason)
        said = "activation refused: joint states arrive, but are refused: "
        assert lab.refusal("activation", reason).startswith(f"{said}{reason}")
