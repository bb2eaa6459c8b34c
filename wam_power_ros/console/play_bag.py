# SPDX-License-Identifier: Apache-2.0
"""Publish the topics of a bag, as `ros2 bag play` does, except those that command or enable an arm.

Recorded torques belong to the recorded states, not to the current ones. A topic that has another
publisher, such as the driver of a real arm, is not played either: playback does not start, or ends
as soon as the other publisher is discovered.
"""

from __future__ import annotations

import importlib
import math
import re
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import QosReliability

from wam_power_ros.bags import layout
from wam_power_ros.bags.bag import Bag, Topic
from wam_power_ros.console.prompt import show
from wam_power_ros.ros import interface
from wam_power_ros.ros.node_runner import participant

DISCOVERY_TIME = 4.0  # [s] to discover other publishers; 2 s are usually enough
CHECK_PERIOD = 1.0  # [s] between checks for publishers that start later
COMMAND_NAMES = re.compile(r"command|cmd", re.IGNORECASE)
COMMAND_TYPES = {"std_msgs/msg/Float64MultiArray", "trajectory_msgs/msg/JointTrajectory"}


def select_topics(bag: Bag, wanted: Sequence[str] = ()) -> tuple[dict[str, Topic], dict[str, str]]:
    """Select the topics of a bag that may be published.

    Args:
        bag: The bag.
        wanted: Topics to play; all if empty.

    Returns:
        Selected topics, and the reason for each excluded topic.

    Raises:
        ValueError: A wanted topic is not in the bag or is a command, or no topic remains.
    """
    found = bag.topics
    if unknown := [name for name in wanted if name not in found]:
        raise ValueError(f"{bag.path}: no topic {', '.join(unknown)}; it has {', '.join(found)}")
    reasons = {name: _danger(bag, name, topic.msgtype) for name, topic in found.items()}
    excluded = {name: reason for name, reason in reasons.items() if reason}
    if refused := [f"{name}: {excluded[name]}" for name in wanted if name in excluded]:
        raise ValueError(f"{'; '.join(refused)}, which is never played")
    names = [name for name in wanted or found if name not in excluded]
    topics = {name: topic for name, topic in found.items() if name in names}
    if not topics:
        raise ValueError(f"{bag.path}: no topic to play; excluded: {excluded or 'none'}")
    return topics, excluded


def _danger(bag: Bag, name: str, msgtype: str) -> str:
    """Reason why a topic must not be published; "" if there is none."""
    if f"/{name}".endswith(f"/{interface.ENABLE}"):
        return "it enables an arm"
    if msgtype in COMMAND_TYPES or COMMAND_NAMES.search(name):
        return "it commands an arm"
    if msgtype == layout.JOINT_STATE:
        for _, _, cdr in bag.messages([name]):
            state = layout.decoded(cdr, msgtype)
            torques_alone = len(state.effort) and not len(state.position) + len(state.velocity)
            return "it commands an arm" if torques_alone else ""
    return ""


def play(path: Path, rate: float = 1.0, wanted: Sequence[str] = (), wait: float = 0.0) -> None:
    """Publish the messages of a bag at the intervals at which they were received.

    Args:
        path: Folder of the bag.
        rate: Speed relative to the recording.
        wanted: Topics to play; all if empty.
        wait: Longest wait for a subscriber of every topic, after discovery [s].

    Raises:
        ValueError: The bag cannot be read, as for `select_topics`, the rate is not positive, a
            message type is not installed, or a topic has another publisher.
    """
    if not 0.0 < rate < math.inf:
        raise ValueError(f"rate {rate} must be positive")
    bag = Bag(path)
    topics, excluded = select_topics(bag, wanted)
    for name, reason in excluded.items():
        show(f"not played: {name}, because {reason}")
    with participant(lambda: Node("player")) as node:
        _Player(node, topics).play(bag, rate, wait)


class _Player:
    """Publishers of the topics of a bag."""

    def __init__(self, node: Node, topics: Mapping[str, Topic]) -> None:
        self._node = node
        self._publishers = {name: self._publisher(name, topic) for name, topic in topics.items()}

    def _publisher(self, name: str, topic: Topic) -> Publisher:
        try:
            package, _, message = topic.msgtype.split("/")
            message_type = getattr(importlib.import_module(f"{package}.msg"), message)
        except (ImportError, AttributeError, ValueError):
            raise ValueError(
                f"{name}: type {topic.msgtype} is not installed; select others with --topics"
            ) from None
        return self._node.create_publisher(message_type, name, qos(topic))

    def play(self, bag: Bag, rate: float, wait: float) -> None:
        time.sleep(DISCOVERY_TIME)
        self._check_alone()
        deadline = time.monotonic() + wait
        while (unsubscribed := self._unsubscribed()) and time.monotonic() < deadline:
            time.sleep(0.05)
        show(f"Playing {', '.join(self._publishers)}; Ctrl-C ends it")
        if unsubscribed:
            show(f"no subscriber of {', '.join(unsubscribed)}")
        start = checked = time.monotonic()
        first_ns, count = None, 0
        for name, stamp_ns, cdr in bag.messages(self._publishers):
            first_ns = stamp_ns if first_ns is None else first_ns
            due = start + (stamp_ns - first_ns) * 1e-9 / rate
            while (left := due - time.monotonic()) > 0.0:
                time.sleep(min(left, CHECK_PERIOD))
            if time.monotonic() - checked > CHECK_PERIOD:
                self._check_alone()
                checked = time.monotonic()
            self._publishers[name].publish(bytes(cdr))
            count += 1
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=DISCOVERY_TIME))
        show(f"played {count} messages in {time.monotonic() - start:.1f} s")

    def _unsubscribed(self) -> list[str]:
        publishers = self._publishers.items()
        return [name for name, each in publishers if not each.get_subscription_count()]

    def _check_alone(self) -> None:
        for name in self._publishers:
            if self._node.count_publishers(name) > 1:
                others = [
                    info.node_name
                    for info in self._node.get_publishers_info_by_topic(name)
                    if info.node_name != self._node.get_name()
                ]
                raise ValueError(
                    f"{name} is published by {', '.join(others) or 'another player'} too: recorded "
                    "and live messages would mix; end it (a killed node stays announced for 20 s)"
                )


def qos(topic: Topic) -> QoSProfile:
    """QoS to publish a topic: as recorded, with a large depth because discovery reports none."""
    reliable = all(item.reliability == QosReliability.RELIABLE for item in topic.offered)
    latched = topic.latched
    return QoSProfile(
        depth=max(item.depth for item in topic.offered) if latched else interface.DEEP.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
