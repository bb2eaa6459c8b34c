# SPDX-License-Identifier: Apache-2.0
"""Endpoints of other nodes that do not match ours: of another message type, or incompatible QoS.

The middleware delivers nothing between them, and reports a difference of types to nobody.
"""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from wam_power_ros.ros.guards import UNNAMED, described

BEST_EFFORT, RELIABLE = ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE
VOLATILE, LATCHED = DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL
OTHER_TYPE = "messages of another type are not received"


def type_name(kind: type) -> str:
    """Full name of a message type, such as `std_msgs/msg/String`."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def unmatched_publishers(
    node: Node, topic: str, types: Sequence[str], qos: QoSProfile | None = None
) -> list[str]:
    """Describe the publishers of a topic, relative or resolved, from which nothing is received.

    Without types any is expected; without a QoS the subscription adapts to the publishers.

    Returns:
        One sentence each, with both sides.
    """
    topic, found = node.resolve_topic_name(topic), []
    wanted = f"{' or '.join(types)}{'' if qos is None else f' (at least {_said(qos)})'}"
    for info in node.get_publishers_info_by_topic(topic):
        if why := _difference(info, types, info.qos_profile, qos or info.qos_profile):
            given = f"{info.topic_type} ({_said(info.qos_profile)})"
            found.append(f"{_node(info)} publishes {given} on {topic}, not {wanted}: {why}")
    return sorted(found)


def unmatched_subscriptions(
    node: Node, topic: str, kind: str, qos: QoSProfile
) -> tuple[list[str], int]:
    """Describe the subscriptions of other nodes that receive nothing, and count those that do.

    Returns:
        One sentence each, with both sides, and the count.
    """
    topic, own = node.resolve_topic_name(topic), (node.get_name(), node.get_namespace())
    infos, found = node.get_subscriptions_info_by_topic(topic), []
    others = [info for info in infos if (info.node_name, info.node_namespace) != own]
    for info in others:
        if why := _difference(info, (kind,), qos, info.qos_profile):
            wanted = f"{info.topic_type} (at least {_said(info.qos_profile)})"
            given = f"published is {kind} ({_said(qos)})"
            found.append(f"{_node(info)} subscribes to {topic} as {wanted}, {given}: {why}")
    return sorted(found), len(others) - len(found)


def _difference(
    info: TopicEndpointInfo, types: Sequence[str], offered: QoSProfile, requested: QoSProfile
) -> str:
    """Why nothing is delivered to or from an endpoint; empty if something is."""
    if types and info.topic_type not in types:
        return OTHER_TYPE
    # Not `qos_check_compatible`: a discovered profile has no deadline other than ours has none.
    pairs = (
        (offered.reliability, BEST_EFFORT, requested.reliability, RELIABLE),
        (offered.durability, VOLATILE, requested.durability, LATCHED),
    )
    return ", ".join(
        f"a {_words(given)} publisher does not serve a {_words(wanted)} subscription"
        for given, weak, wanted, strong in pairs
        if given == weak and wanted == strong
    )


def _said(qos: QoSProfile) -> str:
    return f"{_words(qos.reliability)}, {_words(qos.durability)}"


def _words(policy: ReliabilityPolicy | DurabilityPolicy) -> str:
    return policy.name.lower().replace("_", " ")


def _node(info: TopicEndpointInfo) -> str:
    known = info.node_name != UNNAMED
    return described(f"{info.node_namespace}/{info.node_name}".strip("/") if known else UNNAMED)
