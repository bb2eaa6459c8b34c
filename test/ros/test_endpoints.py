# SPDX-License-Identifier: Apache-2.0
"""Endpoints that do not match ours are named with both sides, and others are not."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from geometry_msgs.msg import Pose, PoseStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray, String

from wam_power_ros.ros import endpoints, interface

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
LATCHED, VOLATILE = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE
POSE = "geometry_msgs/msg/PoseStamped"


def qos(reliability: ReliabilityPolicy, durability: DurabilityPolicy = VOLATILE) -> QoSProfile:
    return QoSProfile(depth=1, reliability=reliability, durability=durability)


def endpoint(kind: type, profile: QoSProfile, node: str = "driver") -> SimpleNamespace:
    return SimpleNamespace(
        node_name=node,
        node_namespace="/cell",
        topic_type=endpoints.type_name(kind),
        qos_profile=profile,
    )


def graph(*found: SimpleNamespace) -> SimpleNamespace:
    """A node that knows these publishers and subscriptions of one topic."""
    return SimpleNamespace(
        resolve_topic_name=lambda name: f"/cell/{name}",
        get_publishers_info_by_topic=lambda name: found if name == "/cell/topic" else (),
        get_subscriptions_info_by_topic=lambda name: found if name == "/cell/topic" else (),
        get_name=lambda: "ours",
        get_namespace=lambda: "/cell",
    )


@pytest.mark.parametrize(
    ("kind", "offered", "requested", "fragments"),
    [
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
    ],
)
def test_a_publisher_that_is_not_received_is_named_with_both_sides(
    kind: type, offered: QoSProfile, requested: QoSProfile, fragments: tuple[str, ...]
) -> None:
    received = endpoint(PoseStamped, qos(RELIABLE, LATCHED), "another")
    known = graph(received, endpoint(kind, offered))
    found = endpoints.unmatched_publishers(known, "topic", (POSE,), requested)
    assert len(found) == bool(fragments)
    for text in found:
        assert text.startswith("node 'cell/driver' publishes ")
        assert " on /cell/topic, not " in text
        assert [part for part in (POSE, *fragments) if part not in text] == []


@pytest.mark.parametrize(
    ("kind", "requested", "fragment"),
    [
        (String, qos(RELIABLE), "as std_msgs/msg/String (at least reliable, volatile)"),
        (Float64MultiArray, qos(RELIABLE, LATCHED), "a volatile publisher does not serve"),
        (Float64MultiArray, qos(BEST_EFFORT), ""),
    ],
)
def test_a_driver_that_does_not_receive_torques_is_named_and_our_own_subscription_is_not(
    kind: type, requested: QoSProfile, fragment: str
) -> None:
    known = graph(endpoint(String, qos(RELIABLE), "ours"), endpoint(kind, requested))
    name = endpoints.type_name(Float64MultiArray)
    texts, matched = endpoints.unmatched_subscriptions(known, "topic", name, interface.COMMAND)
    assert (len(texts), matched) == ((1, 0) if fragment else (0, 1))
    for text in texts:
        assert fragment in text and "published is std_msgs/msg/Float64MultiArray" in text
