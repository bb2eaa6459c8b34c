# SPDX-License-Identifier: Apache-2.0
"""Watch for a robot in the domain of a stand-in: a driver, or another stand-in.

A driver publishes joint states or receives commands. With a stand-in beside it, the torques for the
simulation would move the robot. Another stand-in is accepted in another namespace, a robot nowhere.

    python -m hardware_sim.driver_watch --ros-args --params-file FILE

looks once, before a launch file starts anything, and ends with status 2 where a robot is.
"""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports, which a signal may interrupt
    from wam_power_ros.entry import INTERRUPTED, start

    raise SystemExit(start("hardware_sim.driver_watch", INTERRUPTED))

import math
import os
import time
from collections.abc import Sequence
from pathlib import Path

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from wam_power_ros.ros import interface, network, node_runner, security
from wam_power_ros.ros.domain import FIRST_PORT, PORTS_PER_PARTICIPANT, exported, ports

STAND_IN = "wam_sim"
STATES = "sensor_msgs/msg/JointState"
OURS = {*security.TABLE, "check_driver"}  # nodes that may listen to commands
TOOLS = (
    "_ros2cli",
    "rosbag2",
    "rqt",
    "plotjuggler",
    "foxglove",
)  # so may these, by their beginning
UNNAMED = "_NODE_NAME_UNKNOWN_"  # until the name of an endpoint's node has come, or not a ROS node
DISCOVERY = 10.0  # [s] in which who is there is found: they announce themselves every 3 s
SETTLED = 1.0  # [s] from the discovery of a participant to that of its topics
LISTENERS = "listeners"  # the parameter that names others
# A global id of Fast DDS begins with vendor and host, process (two bytes of its id, two at random),
# and number of the participant.
HOST, PROCESS, PARTICIPANT = 4, 8, 12
EVENTS = "/parameter_events"  # which every node publishes
HEARS = "receives"
EVERY = 0.25  # [s] between two looks


class DriverWatch:
    """Looks at who publishes joint states and who listens to commands.

    Args:
        node: Node of the stand-in.
        command_topic: Topic of the torques.
        listeners: Names of other nodes that may listen to commands, or beginnings of them.
    """

    def __init__(self, node: Node, command_topic: str, listeners: Sequence[str]) -> None:
        self._node = node
        self._mine = self._own_process()
        names = (command_topic, f"/{interface.EFFORT_COMMANDS}")
        self._commands = {node.resolve_topic_name(name) for name in names}
        lockstep = node.get_parameter("pace").value == "lockstep"
        self._clock = node.resolve_topic_name(interface.CLOCK) if lockstep else ""
        self._listeners = (*TOOLS, *filter(None, listeners))
        self._begun = self._looked = time.monotonic()
        own = node.resolve_topic_name(node.get_parameter("state_topic").value)
        self._at_once = {f"publishes {topic}" for topic in (own, self._clock)}
        self._unnamed = 0.0  # when somebody without a name was first seen [s], 0 for nobody

    def check(self) -> None:
        """Wait until those who are there have been discovered.

        Raises:
            ValueError: A robot, or another stand-in, is in this domain.
        """
        domain = exported(os.environ)
        here_only = network.wider_reach(os.environ) is None
        known = math.inf  # since when everybody is
        while True:
            now, others = time.monotonic(), _participants(domain)
            name, what = self._robot()
            end = self._begun + DISCOVERY if others or not here_only else 0.0
            if name and (name != UNNAMED or now > end):
                raise ValueError(
                    f"{_named(name)} {what} in DDS domain {domain}: a simulation must not meet a "
                    "robot; start it in another domain: export ROS_DOMAIN_ID=N"
                )
            everybody = here_only and self._known() >= others
            known = min(known, now) if everybody else math.inf
            if not name and now > min(end, known + SETTLED):
                return
            time.sleep(0.05)

    def look(self) -> str:
        """Who has appeared, in words; not looked for more often than every `EVERY` [s]."""
        now = time.monotonic()
        if now < self._looked + EVERY:
            return ""
        self._looked = now
        name, what = self._robot()
        patient = name == UNNAMED and what not in self._at_once
        if patient and now < (self._unnamed or now) + DISCOVERY:
            self._unnamed = self._unnamed or now  # its name may be on its way: another stand-in's
            return ""
        self._unnamed = 0.0
        return f"{_named(name)} {what}" if name else ""

    def _robot(self) -> tuple[str, str]:
        """Name of a node that a simulation must not meet, and what it does; empty for none."""
        node = self._node
        for topic, types in node.get_topic_names_and_types():
            if topic == self._clock or (STATES in types and topic not in self._commands):
                for other in self._others(node.get_publishers_info_by_topic(topic)):
                    if topic == self._clock or not self._beside(other):
                        return other.node_name, f"publishes {topic}"
        for topic in self._commands:
            for other in self._others(node.get_subscriptions_info_by_topic(topic)):
                name = other.node_name
                if name not in OURS and not name.startswith(self._listeners):
                    return name, f"{HEARS} {topic}"
        return "", ""

    def _beside(self, other: TopicEndpointInfo) -> bool:
        """Whether an endpoint is of a stand-in in another namespace, which commands its own arm."""
        elsewhere = other.node_namespace != self._node.get_namespace()
        return elsewhere and other.node_name == STAND_IN

    def _known(self) -> int:
        """Number of participants of other processes that have been discovered."""
        events = self._node.get_publishers_info_by_topic(EVENTS)
        return len({gid[:PARTICIPANT] for gid, _ in self._alive(events)})

    def _others(self, endpoints: Sequence[TopicEndpointInfo]) -> list[TopicEndpointInfo]:
        """Endpoints in other processes that are alive."""
        return [endpoint for _, endpoint in self._alive(endpoints)]

    def _alive(
        self, endpoints: Sequence[TopicEndpointInfo]
    ) -> list[tuple[bytes, TopicEndpointInfo]]:
        """Global ids of endpoints in other processes that are alive, and these.

        A killed process of this machine stays announced for 20 s.
        """
        gids = [(bytes(each.endpoint_gid), each) for each in endpoints]
        if not self._mine:  # another middleware
            mine = self._node.get_name(), self._node.get_namespace()
            return [each for each in gids if (each[1].node_name, each[1].node_namespace) != mine]
        others = [each for each in gids if each[0][:PROCESS] != self._mine]
        if not others:
            return []
        ids = (path.name for path in Path("/proc").glob("[0-9]*"))
        running = {_low_bytes(int(id)) for id in ids}
        here = self._mine[:HOST]
        return [each for each in others if each[0][:HOST] != here or each[0][HOST:][:2] in running]

    def _own_process(self) -> bytes:
        """How the global ids of this process begin; empty where they are not those of Fast DDS."""
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            for each in self._node.get_publishers_info_by_topic(EVENTS):
                gid = bytes(each.endpoint_gid)
                if gid[HOST:][:2] == _low_bytes(os.getpid()):
                    return gid[:PROCESS]
            time.sleep(0.01)
        return b""


def _low_bytes(process: int) -> bytes:
    return (process & 0xFFFF).to_bytes(2, "little")


def _participants(domain: int) -> int:
    """Number of other DDS participants of a domain on this machine, by their ports of discovery."""
    own = {int(address.rpartition(":")[2]) for address in network.bound_addresses()}
    others = network.ports_in_use() & set(ports(domain)) - own
    return sum((port - FIRST_PORT) % PORTS_PER_PARTICIPANT == 0 for port in others)


def _named(name: str) -> str:
    return "a program without a name" if name == UNNAMED else f"node {name!r}"


class _Look(Node):
    """A node with the parameters of the stand-in and nothing else of it."""

    def __init__(self) -> None:
        super().__init__(STAND_IN, automatically_declare_parameters_from_overrides=True)

    def look(self) -> None:
        topic, listeners = (self.get_parameter(name).value for name in ("command_topic", LISTENERS))
        DriverWatch(self, topic, listeners).check()


def main() -> int:
    """Look once; returns REFUSED where a robot is."""
    return node_runner.run_script(_Look, _Look.look)
