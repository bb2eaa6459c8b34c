# SPDX-License-Identifier: Apache-2.0
"""Endpoints that do not match ours are named with both sides, and others are not."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest
import rclpy
from geometry_msgs.msg import Pose, PoseStamped, TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray, String

from wam_power_ros.ros import endpoints, interface

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
LATCHED, VOLATILE = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE
POSE = "geometry_msgs/msg/PoseStamped"


def qos(reliability: ReliabilityPolicy, durability: DurabilityPolicy = VOLATILE) -> QoSProfile:
    return QoSProfile(depth=1, reliability=reliability, durability=durability)


Make = Callable[[str], Node]


@pytest.fixture
def make(domain_id: int) -> Iterator[Make]:
    """Makes nodes in a namespace, each a participant: one cannot have two types on a topic."""
    made: list[Node] = []

    def make(name: str) -> Node:
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain_id)
        made.append(rclpy.create_node(name, context=context, namespace="cell"))
        return made[-1]

    yield make
    for node in made:
        rclpy.shutdown(context=node.context)


@pytest.fixture
def nodes(make: Make) -> tuple[Node, Node]:
    """Ours, and a driver."""
    return make("ours"), make("driver")


def discovered(find: Callable[[], object], wanted: Callable[[object], bool]) -> object:
    """What is found once it is as wanted; fails after 10 s."""
    for _ in range(200):
        if wanted(found := find()):
            return found
        time.sleep(0.05)
    pytest.fail(f"never as wanted: {found}")


@pytest.mark.parametrize(
    ("kind", "offered", "requested", "fragments"),
    [
        (
            TransformStamped,
            qos(RELIABLE),
            qos(BEST_EFFORT),
            ("geometry_msgs/msg/TransformStamped (reliable, volatile)", endpoints.OTHER_TYPE),
        ),
        (Pose, qos(RELIABLE), qos(BEST_EFFORT), ("geometry_msgs/msg/Pose (", "another type")),
        (
            PoseStamped,
            qos(BEST_EFFORT),
            qos(RELIABLE),
            (f"{POSE} (best effort, volatile)", "at least reliable, volatile", "best effort pub"),
        ),
        (
            PoseStamped,
            qos(RELIABLE),
            qos(RELIABLE, LATCHED),
            ("(reliable, volatile)", "at least reliable, transient local", "volatile publisher"),
        ),
        (PoseStamped, qos(RELIABLE), qos(BEST_EFFORT), ()),
        (PoseStamped, qos(RELIABLE, LATCHED), qos(BEST_EFFORT), ()),
        (PoseStamped, qos(BEST_EFFORT), None, ()),  # it adapts
    ],
)
def test_a_publisher_that_is_not_received_is_named_with_both_sides(
    nodes: tuple[Node, Node],
    kind: type,
    offered: QoSProfile,
    requested: QoSProfile | None,
    fragments: tuple[str, ...],
) -> None:
    ours, driver = nodes
    driver.create_publisher(kind, "/pancake/pose", offered)
    known = lambda: ours.count_publishers("/pancake/pose")  # noqa: E731
    discovered(known, bool)
    find = lambda: endpoints.unmatched_publishers(ours, "/pancake/pose", (POSE,), requested)  # noqa: E731
    if not fragments:
        assert find() == []
        return
    (text,) = discovered(find, lambda found: found and "'cell/driver'" in found[0])
    assert text.startswith("node 'cell/driver' publishes ") and " on /pancake/pose, not " in text
    assert [part for part in (POSE, *fragments) if part not in text] == []


def test_of_several_publishers_only_those_that_are_not_received_are_named(make: Make) -> None:
    ours = make("ours")
    for kind, reliability in (
        (PoseStamped, RELIABLE),
        (TransformStamped, RELIABLE),
        (PoseStamped, BEST_EFFORT),
        (String, BEST_EFFORT),
    ):
        make("driver").create_publisher(kind, "/pancake/pose", qos(reliability))
    find = lambda: endpoints.unmatched_publishers(  # noqa: E731
        ours, "/pancake/pose", (POSE,), interface.MOCAP_BEST_EFFORT
    )
    discovered(lambda: ours.count_publishers("/pancake/pose"), lambda count: count == 4)
    found = find()
    assert len(found) == 2 and "String" in str(found) and "TransformStamped" in str(found)
    assert endpoints.unmatched_publishers(ours, "pancake/pose", (POSE,)) == []


@pytest.mark.parametrize(
    ("kind", "requested", "fragment"),
    [
        (String, qos(RELIABLE), "as std_msgs/msg/String (at least reliable, volatile)"),
        (
            Float64MultiArray,
            qos(RELIABLE, LATCHED),
            "a volatile publisher does not serve",
        ),
        (Float64MultiArray, qos(BEST_EFFORT), ""),
    ],
)
def test_a_driver_that_does_not_receive_torques_is_named_and_our_own_subscription_is_not(
    nodes: tuple[Node, Node], kind: type, requested: QoSProfile, fragment: str
) -> None:
    ours, driver = nodes
    ours.create_subscription(String, "commands", lambda _: None, 1)
    driver.create_subscription(kind, "commands", lambda _: None, requested)
    discovered(lambda: ours.count_subscribers("commands"), lambda count: count == 2)
    name = endpoints.type_name(Float64MultiArray)
    find = lambda: endpoints.unmatched_subscriptions(ours, "commands", name, interface.COMMAND)  # noqa: E731
    counts = (1, 0) if fragment else (0, 1)  # names are discovered later than topics
    texts, _ = discovered(find, lambda found: (len(found[0]), found[1]) == counts)
    if fragment:
        assert fragment in texts[0] and "published is std_msgs/msg/Float64MultiArray" in texts[0]
