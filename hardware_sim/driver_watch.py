# SPDX-License-Identifier: Apache-2.0
"""Detect a real driver or another stand-in in the DDS domain of a stand-in.

A driver publishes joint states or subscribes to commands. With a stand-in beside it, the torques
for the simulation would move the robot. A stand-in in another namespace is allowed, a robot is not
allowed in any.
"""

from __future__ import annotations

import math
import os
import time

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from wam_power_ros.ros import interface, network
from wam_power_ros.ros.domain import FIRST_PORT, PORTS_PER_PARTICIPANT, exported, ports
from wam_power_ros.ros.guards import STAND_IN, UNNAMED, described

STATE_TYPE = "sensor_msgs/msg/JointState"
# Nodes that may subscribe to commands.
OWN_NODES = {"torque_controller", "demonstration_recorder", "check_driver", STAND_IN}
TOOL_PREFIXES = ("_ros2cli", "rosbag2", "rqt", "plotjuggler", "foxglove")  # and these
DISCOVERY_TIME = 10.0  # [s] to discover all participants, which announce themselves every 3 s
SETTLE_TIME = 1.0  # [s] from the discovery of a participant to that of its topics
CHECK_PERIOD = 0.25  # [s] between checks for a robot while the simulation runs
EVENTS = "/parameter_events"  # every node publishes it
PARTICIPANT_SIZE = 12  # bytes of a global id that name its participant (RTPS 2.2, 9.3.1)


class DriverWatch:
    """Checks who publishes joint states and who subscribes to commands beside a stand-in's node."""

    def __init__(self, node: Node) -> None:
        self._node = node
        parameter = {
            name: node.get_parameter(name).value
            for name in ("pace", "state_topic", "command_topic", "listeners")
        }
        names = (parameter["command_topic"], f"/{interface.EFFORT_COMMANDS}")
        self._command_topics = {node.resolve_topic_name(name) for name in names}
        lockstep = parameter["pace"] == "lockstep"
        self._clock_topic = node.resolve_topic_name(interface.CLOCK) if lockstep else ""
        self._listeners = (*TOOL_PREFIXES, *filter(None, parameter["listeners"]))
        self._start_time = self._check_time = time.monotonic()
        own_states = node.resolve_topic_name(parameter["state_topic"])
        self._own_outputs = {f"publishes {topic}" for topic in (own_states, self._clock_topic)}
        self._unnamed_since = 0.0  # [s] first sight of a participant without a name, 0 for none

    def check(self) -> None:
        """Wait until discovery is complete.

        Raises:
            ValueError: A robot, or a stand-in in the same namespace, is in this domain; or the
                middleware cannot be confined to this machine, nor its participants be counted.
        """
        if unrestricted := network.unrestricted_middleware():
            raise ValueError(
                f"the middleware is {unrestricted}: a simulation might reach a robot; run it with "
                f"RMW_IMPLEMENTATION={network.MIDDLEWARE}"
            )
        domain = exported(os.environ)
        loopback_only = network.wider_reach(os.environ) is None
        complete_since = math.inf
        while True:
            now, participants = time.monotonic(), _participants(domain)
            name, activity = self._robot()
            alone = loopback_only and participants <= 1
            deadline = 0.0 if alone else self._start_time + DISCOVERY_TIME
            if name and (name != UNNAMED or now > deadline):
                raise ValueError(
                    f"{described(name)} {activity} in DDS domain {domain}: a simulation must not "
                    "share a domain with a robot; choose another one: export ROS_DOMAIN_ID=N"
                )
            complete = loopback_only and self._discovered() >= participants
            complete_since = min(complete_since, now) if complete else math.inf
            if not name and now > min(deadline, complete_since + SETTLE_TIME):
                return
            time.sleep(0.05)

    def look(self) -> str:
        """Describe a robot that has appeared; "" for none and between checks."""
        now = time.monotonic()
        if now < self._check_time + CHECK_PERIOD:
            return ""
        self._check_time = now
        name, activity = self._robot()
        tolerated = name == UNNAMED and activity not in self._own_outputs
        if tolerated and now < (self._unnamed_since or now) + DISCOVERY_TIME:
            self._unnamed_since = self._unnamed_since or now  # it may prove to be a stand-in
            return ""
        self._unnamed_since = 0.0
        return f"{described(name)} {activity}" if name else ""

    def _robot(self) -> tuple[str, str]:
        """Name and activity of a node that must not share the domain; empty for none."""
        node = self._node
        for topic, types in node.get_topic_names_and_types():
            is_clock = topic == self._clock_topic
            if is_clock or (STATE_TYPE in types and topic not in self._command_topics):
                for other in self._others(topic):
                    if is_clock or not self._is_stand_in_elsewhere(other):
                        return other.node_name, f"publishes {topic}"
        for topic in self._command_topics:
            for other in node.get_subscriptions_info_by_topic(topic):
                name = other.node_name
                itself = (name, other.node_namespace) == (node.get_name(), node.get_namespace())
                if name not in OWN_NODES and not itself and not name.startswith(self._listeners):
                    told = "(if it is no driver, name it in `listeners` of wam_sim)"
                    return name, f"receives {topic} {told}"
        return "", ""

    def _is_stand_in_elsewhere(self, other: TopicEndpointInfo) -> bool:
        """Whether an endpoint is of a stand-in in another namespace, with an arm of its own."""
        elsewhere = other.node_namespace != self._node.get_namespace()
        return elsewhere and other.node_name == STAND_IN

    def _others(self, topic: str) -> list[TopicEndpointInfo]:
        """Publishers of a topic, without those of this node."""
        node = self._node
        name = node.get_name(), node.get_namespace()
        found = node.get_publishers_info_by_topic(topic)
        found.sort(key=lambda each: (each.node_name, each.node_namespace) != name)
        return found[sum(own.topic_name == topic for own in node.publishers) :]

    def _discovered(self) -> int:
        """Number of participants that have been discovered, this one included."""
        events = self._node.get_publishers_info_by_topic(EVENTS)
        return len({bytes(each.endpoint_gid)[:PARTICIPANT_SIZE] for each in events})


def _participants(domain: int) -> int:
    """Number of DDS participants of a domain on this machine, by their discovery ports."""
    used = network.ports_in_use() & set(ports(domain))
    return sum((port - FIRST_PORT) % PORTS_PER_PARTICIPANT == 0 for port in used)
