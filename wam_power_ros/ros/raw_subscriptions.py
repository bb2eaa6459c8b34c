# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to topics of any type, which receive serialized messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosbags.interfaces import Qos

from wam_power_ros.bags import layout
from wam_power_ros.ros import endpoints, interface
from wam_power_ros.ros.body_sources import message_class
from wam_power_ros.ros.interface import is_latched, is_reliable

DISCOVERY_PERIOD = 0.25  # [s] between looks at the graph


class _Subscribed(NamedTuple):
    msgtype: str
    reliable: bool
    latched: bool
    subscription: Subscription


class RawTopics:
    """Subscribes to a topic once a publisher is discovered, reliably if all its publishers are.

    An earlier subscription would have to guess the QoS, and a reliable one receives nothing from a
    best-effort driver. The event for lost messages is not used: in rmw_fastrtps of Jazzy it takes
    two locks in the wrong order, and a process that loses messages may be blocked for ever.
    """

    def __init__(
        self,
        node: Node,
        topics: Mapping[str, Sequence[str]],
        on_message: Callable[[str, bytes], None],
    ) -> None:
        """Subscribe to topics with their expected types, none for that of the first publisher.

        `on_message` gets the resolved topic and the bytes of each message.
        """
        self._node, self._on_message = node, on_message
        self._types = {node.resolve_topic_name(topic): topics[topic] for topic in topics}
        self.unmatched: dict[str, list[str]] = {}  # topic -> publishers that are not received
        self._subscribed: dict[str, _Subscribed] = {}
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(DISCOVERY_PERIOD, self.discover, clock=steady)

    @property
    def names(self) -> list[str]:
        """Resolved names of the topics."""
        return list(self._types)

    def layout_of(self, name: str) -> tuple[str, list[Qos]]:
        """Message type of a subscribed topic and QoS of its publishers, for a bag."""
        known, infos = self._subscribed[name], self._node.get_publishers_info_by_topic(name)
        offered = [(is_reliable(it), is_latched(it), it.qos_profile.depth) for it in infos]
        own = [(known.reliable, known.latched)]
        return known.msgtype, [layout.qos(*each) for each in offered or own]

    def discover(self) -> None:
        """Subscribe to every topic that has a publisher."""
        for name in self._types:
            infos = self._node.get_publishers_info_by_topic(name)
            if not infos:
                self.unmatched.pop(name, None)
                continue
            known = self._subscribed.get(name)
            types = (known.msgtype,) if known else self._types[name] or (infos[0].topic_type,)
            usable = [info for info in infos if info.topic_type in types]
            if usable:
                self._subscribe(name, [i for i in usable if i.topic_type == usable[0].topic_type])
            self._find_unmatched(name, types)

    def _find_unmatched(self, name: str, types: Sequence[str]) -> None:
        found = endpoints.unmatched_publishers(self._node, name, types)
        for text in set(found) - set(self.unmatched.get(name, ())):
            self._node.get_logger().error(f"not recorded: {text}")
        self.unmatched[name] = found

    def take(self) -> None:
        """Pass on the messages that have arrived but were not dispatched yet.

        At most one queue of each topic: without this limit, a slow reader would never finish.
        """
        for name, known in self._subscribed.items():
            handle = known.subscription.handle
            with handle:
                for _ in range(interface.STATE_RECORD.depth):
                    if (taken := handle.take_message(known.subscription.msg_type, True)) is None:
                        break
                    self._on_message(name, taken[0])

    def _subscribe(self, name: str, infos: list[TopicEndpointInfo]) -> None:
        msgtype = infos[0].topic_type
        reliable, latched = all(map(is_reliable, infos)), all(map(is_latched, infos))
        known = self._subscribed.get(name)
        if known is not None:
            if (reliable or not known.reliable) and (latched or not known.latched):
                return
            self._node.destroy_subscription(known.subscription)  # a new publisher offers less
        elif msgtype not in layout.TYPES.fielddefs:
            text = f"{name}: cannot record message type {msgtype}"
            self._node.get_logger().error(text, once=True)
            return
        qos = interface.qos(
            interface.STATE_RECORD.depth,
            "RELIABLE" if reliable else "BEST_EFFORT",
            "TRANSIENT_LOCAL" if latched else "VOLATILE",
        )
        kind, receive = message_class(msgtype), partial(self._on_message, name)
        subscription = self._node.create_subscription(kind, name, receive, qos, raw=True)
        self._subscribed[name] = _Subscribed(msgtype, reliable, latched, subscription)
