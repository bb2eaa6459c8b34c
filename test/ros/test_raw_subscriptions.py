# SPDX-License-Identifier: Apache-2.0
"""Raw subscriptions take the QoS of the present publishers, and adapt to a weaker one."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
import rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64, String

from wam_power_ros.ros import interface, node_runner
from wam_power_ros.ros.raw_subscriptions import RawTopics

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
LATCHED, VOLATILE = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE


def _participant(node: Node) -> rclpy.Context:
    """Context of another participant: one cannot have two types on a topic."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=node.context.get_domain_id())
    return context


class Recorder:
    """A node with raw subscriptions, and publishers to drive them."""

    def __init__(self) -> None:
        self.node, self.sender = Node("recorder"), Node("sender")
        self.other = Node("other", context=_participant(self.node))
        self.received: list[tuple[str, str]] = []
        self.topics = RawTopics(self.node, {"notes": ()}, self._on_message)
        self._executor = node_runner.executor_for(self.node)

    def _on_message(self, topic: str, cdr: bytes) -> None:
        self.received.append((topic, deserialize_message(cdr, String).data))

    def publish(
        self, text: str, reliability: ReliabilityPolicy, durability: DurabilityPolicy
    ) -> Publisher:
        """Publish from a new publisher until the text is received, for 10 s at most."""
        qos = QoSProfile(depth=1, reliability=reliability, durability=durability)
        publisher = self.sender.create_publisher(String, "notes", qos)
        for _ in range(200):
            publisher.publish(String(data=text))
            self._executor.spin_once(timeout_sec=0.05)
            if ("/notes", text) in self.received:
                return publisher
        pytest.fail(f"{text} was not received")


@pytest.fixture
def recorder(domain_id: int) -> Iterator[Recorder]:
    rclpy.init(domain_id=domain_id)
    try:
        recorder = Recorder()
        yield recorder
        recorder.sender.destroy_node()
        rclpy.shutdown(context=recorder.other.context)
        recorder.node.destroy_node()
    finally:
        rclpy.shutdown()


def test_what_has_arrived_is_passed_on_before_it_is_dispatched(recorder: Recorder) -> None:
    publisher = recorder.publish("first", RELIABLE, VOLATILE)
    publisher.publish(String(data="last"))
    for _ in range(200):
        recorder.topics.take()
        if ("/notes", "last") in recorder.received:
            break
        time.sleep(0.05)
    else:
        pytest.fail("not passed on")
    recorder.publish("next", RELIABLE, VOLATILE)  # dispatched as usual
    assert [text for _, text in recorder.received].count("last") == 1


def test_what_arrives_faster_than_it_is_passed_on_keeps_nobody(recorder: Recorder) -> None:
    publisher = recorder.publish("first", RELIABLE, VOLATILE)
    message = recorder.received.append

    def answered(name: str, cdr: bytes) -> None:
        message((name, "again"))
        assert len(recorder.received) <= 1 + interface.STATE_RECORD.depth
        for _ in range(2):
            publisher.publish(String(data="again"))

    recorder.topics._on_message = answered
    publisher.publish(String(data="again"))
    time.sleep(0.2)
    recorder.topics.take()
    assert len(recorder.received) > 1


def test_a_subscription_follows_publishers_that_offer_less(recorder: Recorder) -> None:
    recorder.publish("first", RELIABLE, LATCHED)
    msgtype, (offered,) = recorder.topics.layout_of("/notes")
    assert msgtype == "std_msgs/msg/String"
    assert (offered.reliability.name, offered.durability.name) == ("RELIABLE", "TRANSIENT_LOCAL")
    recorder.publish("second", BEST_EFFORT, VOLATILE)  # a reliable subscription would not match it
    assert recorder.node.count_subscribers("/notes") == 1
    assert len(recorder.topics.layout_of("/notes")[1]) == 2


def test_the_first_type_of_a_topic_is_recorded_and_every_other_is_named(recorder: Recorder) -> None:
    recorder.publish("first", RELIABLE, VOLATILE)
    recorder.other.create_publisher(Float64, "notes", QoSProfile(depth=1, reliability=BEST_EFFORT))
    for _ in range(200):
        recorder.topics.discover()
        if "'other'" in str(recorder.topics.unmatched["/notes"]):
            break
        time.sleep(0.05)
    (text,) = recorder.topics.unmatched["/notes"]
    assert text.startswith("node 'other' publishes std_msgs/msg/Float64 (best effort, volatile)")
    assert "not std_msgs/msg/String: messages of another type" in text
    recorder.publish("next", RELIABLE, VOLATILE)
    assert recorder.topics.layout_of("/notes")[0] == "std_msgs/msg/String"
    assert recorder.topics._subscribed["/notes"].reliable  # whatever the other type offers
