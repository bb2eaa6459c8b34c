# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to whatever is published on some topics, handing on the serialized messages."""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import QoSMessageLostInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosbags.interfaces import Qos

from wam_power_ros.bags import layout
from wam_power_ros.ros import interface

LOOK_PERIOD = 0.25  # [s]


class _Tap(NamedTuple):
    msgtype: str
    reliable: bool
    latched: bool
    subscription: Subscription


class RawTopics:
    """Subscribes when a publisher shows up, as its publishers offer it: reliable if all are.

    A subscription made earlier would have to guess, and one that guesses reliable hears nothing of
    a best-effort driver.

    Attributes:
        lost: Messages that were sent and will not come, by topic, as the middleware counts them.
    """

    def __init__(
        self, node: Node, topics: Iterable[str], on_message: Callable[[str, bytes], None]
    ) -> None:
        """Call `on_message` with the resolved topic and the bytes of each message."""
        self._node, self._on_message = node, on_message
        self._topics = {node.resolve_topic_name(topic): topic for topic in topics}
        self._taps: dict[str, _Tap] = {}
        self.lost: Counter[str] = Counter()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(LOOK_PERIOD, self.look, clock=steady)

    @property
    def names(self) -> list[str]:
        """Topics, resolved."""
        return list(self._topics)

    def msgtype(self, name: str) -> str:
        """Type of a topic that has been heard."""
        return self._taps[name].msgtype

    def offered(self, name: str) -> list[Qos]:
        """QoS of the publishers of a topic that has been heard, as a bag notes it."""
        infos = self._node.get_publishers_info_by_topic(name)
        tap = self._taps[name]
        return [
            layout.qos(_is_reliable(info), _is_latched(info), info.qos_profile.depth)
            for info in infos
        ] or [layout.qos(tap.reliable, tap.latched)]

    def look(self) -> None:
        """Subscribe to what has a publisher by now."""
        for name in self._topics:
            infos = self._node.get_publishers_info_by_topic(name)
            if infos:
                self._fit(name, infos)

    def _fit(self, name: str, infos: list[TopicEndpointInfo]) -> None:
        msgtype = infos[0].topic_type
        reliable, latched = all(map(_is_reliable, infos)), all(map(_is_latched, infos))
        tap = self._taps.get(name)
        if tap is not None:
            if (reliable or not tap.reliable) and (latched or not tap.latched):
                return
            self._node.destroy_subscription(tap.subscription)  # a newcomer offers less
        elif msgtype not in layout.TYPES.fielddefs:
            self._node.get_logger().error(f"{name}: cannot record type {msgtype}", once=True)
            return
        qos = QoSProfile(
            depth=interface.STATE_RECORD.depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        package, _, message = msgtype.split("/")
        subscription = self._node.create_subscription(
            getattr(importlib.import_module(f"{package}.msg"), message),
            self._topics[name],
            partial(self._on_message, name),
            qos,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(message_lost=partial(self._on_lost, name)),
        )
        self._taps[name] = _Tap(msgtype, reliable, latched, subscription)

    def _on_lost(self, name: str, info: QoSMessageLostInfo) -> None:
        self.lost[name] += info.total_count_change


def _is_reliable(info: TopicEndpointInfo) -> bool:
    return info.qos_profile.reliability == ReliabilityPolicy.RELIABLE


def _is_latched(info: TopicEndpointInfo) -> bool:
    return info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
