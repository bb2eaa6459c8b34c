# SPDX-License-Identifier: Apache-2.0
"""A bag played as topics, as `ros2 bag play` does: for nodes to hear, never for an arm to follow.

What commands an arm or releases it is left out: recorded torques answer the states of then. Nor is
a topic played beside somebody who publishes it, such as the driver of a real arm: it is not begun,
or ended as soon as the other is discovered.
"""

from __future__ import annotations

import importlib
import math
import os
import re
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import QosDurability, QosReliability

from wam_power_ros.bags import reader
from wam_power_ros.ros import interface
from wam_power_ros.ros.node_runner import number_by_process

LOOK_AROUND = 4.0  # [s] in which others that are there are found, as a rule within 2
LOOK_PERIOD = 1.0  # [s] for publishers that come later
DEPTH = 4000  # messages kept for a reader that is late
COMMAND_NAMES = re.compile(r"command|cmd", re.IGNORECASE)
COMMAND_TYPES = {"std_msgs/msg/Float64MultiArray", "trajectory_msgs/msg/JointTrajectory"}


def chosen(
    path: Path, wanted: Sequence[str] = ()
) -> tuple[dict[str, reader.Topic], dict[str, str]]:
    """Topics of a bag that are to be played, and those left out with the reason.

    Args:
        path: Of the bag.
        wanted: Of these topics alone; of all if empty.

    Raises:
        ValueError: It is no bag, a wanted topic is not in it or is a command, nothing is left.
    """
    found = reader.topics(path)
    if unknown := [name for name in wanted if name not in found]:
        raise ValueError(f"{path}: no topic {', '.join(unknown)}; it has {', '.join(found)}")
    reasons = {name: _command(path, name, topic.msgtype) for name, topic in found.items()}
    left_out = {name: why for name, why in reasons.items() if why}
    if refused := [f"{name}: {left_out[name]}" for name in wanted if name in left_out]:
        raise ValueError(f"{'; '.join(refused)}, which is never played")
    topics = {name: topic for name, topic in found.items() if name in (wanted or found)}
    topics = {name: topic for name, topic in topics.items() if name not in left_out}
    if not topics:
        raise ValueError(f"{path}: nothing to play; left out: {left_out or 'nothing'}")
    return topics, left_out


def _command(path: Path, name: str, msgtype: str) -> str:
    """Why a topic counts as a command to an arm; empty if it does not."""
    if name == interface.ENABLE:
        return "it releases an arm"
    if msgtype in COMMAND_TYPES or COMMAND_NAMES.search(name):
        return "it commands an arm"
    if msgtype == reader.JOINT_STATE:
        for _, _, cdr in reader.messages(path, [name]):
            state = reader.TYPES.deserialize_cdr(cdr, msgtype)
            torques_alone = len(state.effort) and not len(state.position) + len(state.velocity)
            return "it commands an arm" if torques_alone else ""
    return ""


def play(path: Path, rate: float = 1.0, wanted: Sequence[str] = (), wait: float = 0.0) -> None:
    """Publish the messages of a bag as far apart as they were received; says what it does.

    Args:
        path: Of the bag.
        rate: 1 for as recorded, 2 for twice as fast.
        wanted: These topics alone.
        wait: For a reader of every topic, after a look around, at most [s].

    Raises:
        ValueError: As `chosen`; a rate that is not positive, a type that is not installed, another
            publisher of one of the topics.
    """
    if not 0.0 < rate < math.inf:
        raise ValueError(f"rate {rate} must be positive")
    topics, left_out = chosen(path, wanted)
    for name, why in left_out.items():
        _say(f"not played: {name}, for {why}")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = rclpy.Context()
    rclpy.init(context=context)
    try:
        with number_by_process():
            node = Node("player", context=context)
        _Player(node, topics).play(path, rate, wait)
    finally:
        rclpy.try_shutdown(context=context)


class _Player:
    def __init__(self, node: Node, topics: Mapping[str, reader.Topic]) -> None:
        self._node = node
        self._publishers = {name: self._publisher(name, topic) for name, topic in topics.items()}

    def _publisher(self, name: str, topic: reader.Topic) -> Publisher:
        package, _, message = topic.msgtype.split("/")
        try:
            kind = getattr(importlib.import_module(f"{package}.msg"), message)
        except (ImportError, AttributeError):
            raise ValueError(
                f"{name}: type {topic.msgtype} is not installed; choose others with --topics"
            ) from None
        return self._node.create_publisher(kind, name, qos(topic))

    def play(self, path: Path, rate: float, wait: float) -> None:
        time.sleep(LOOK_AROUND)
        self._check_alone()
        end = time.monotonic() + wait
        while time.monotonic() < end and not all(map(_readers, self._publishers.values())):
            time.sleep(0.05)
        silent = [name for name, each in self._publishers.items() if not _readers(each)]
        _say(f"Playing {', '.join(self._publishers)}; Ctrl-C ends it")
        if silent:
            _say(f"nobody listens to {', '.join(silent)}")
        begun, looked, first_ns, count = time.monotonic(), time.monotonic(), None, 0
        for name, stamp_ns, cdr in reader.messages(path, self._publishers):
            first_ns = stamp_ns if first_ns is None else first_ns
            due = begun + (stamp_ns - first_ns) * 1e-9 / rate
            while (left := due - time.monotonic()) > 0.0:
                time.sleep(min(left, LOOK_PERIOD))
            if time.monotonic() - looked > LOOK_PERIOD:
                self._check_alone()
                looked = time.monotonic()
            self._publishers[name].publish(bytes(cdr))
            count += 1
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=LOOK_AROUND))
        _say(f"played {count} messages in {time.monotonic() - begun:.1f} s")

    def _check_alone(self) -> None:
        for name in self._publishers:
            if self._node.count_publishers(name) > 1:
                others = [
                    info.node_name
                    for info in self._node.get_publishers_info_by_topic(name)
                    if info.node_name != self._node.get_name()
                ]
                raise ValueError(
                    f"{name} is published by {', '.join(others) or 'another player'} too; nobody "
                    "could tell what was recorded from what is (a killed node counts for 20 s)"
                )


def qos(topic: reader.Topic) -> QoSProfile:
    """The QoS to play a topic with: as recorded, but deep, for the graph does not tell a depth."""
    reliable = all(item.reliability == QosReliability.RELIABLE for item in topic.offered)
    latched = bool(topic.offered) and all(
        item.durability == QosDurability.TRANSIENT_LOCAL for item in topic.offered
    )
    return QoSProfile(
        depth=max(item.depth for item in topic.offered) if latched else DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _readers(publisher: Publisher) -> int:
    return publisher.get_subscription_count()


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
