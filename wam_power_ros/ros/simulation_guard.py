# SPDX-License-Identifier: Apache-2.0
"""Guard of a simulated controller: it may answer states of a stand-in only, and by its clock."""

from __future__ import annotations

from rclpy.node import Node

from wam_power_ros.ros import interface

STAND_IN = "wam_sim"  # node that publishes the joint states of a simulated arm
UNNAMED = "_NODE_NAME_UNKNOWN_"  # the node's name is not discovered yet, or it is no ROS node


def described(name: str) -> str:
    """Name of a node as it is discovered, for a sentence."""
    return "a participant without a node name" if name == UNNAMED else f"node {name!r}"


class SimulationGuard:
    """Looks who publishes the joint states that a controller in simulation answers.

    A stand-in is recognised by the name of its node, as `hardware_sim.driver_watch` does. An arm,
    whose controller is not `simulated`, needs no guard.
    """

    def __init__(self, node: Node, topic: str, simulated: bool = True) -> None:
        self._node, self._topic = node, node.resolve_topic_name(topic)
        self._simulated = simulated
        self._clock = node.resolve_topic_name(interface.CLOCK)
        self._unnamed = False  # at the last call of `intruder`

    def stranger(self) -> str | None:
        """Describe a publisher of joint states that is no stand-in; None if there is none."""
        name = self._stranger()
        if name is None:
            return None
        return (
            f"{described(name)} publishes {self._topic}, and this controller is for a simulation: "
            f"it answers the stand-in {STAND_IN!r} only; for an arm set simulation: false"
        )

    def other_clock(self, lockstep: bool) -> str:
        """Say that stand-in and controller follow different clocks; empty if they do not."""
        if not self._simulated:
            return ""
        published = bool(self._node.count_publishers(self._clock))
        if published and not lockstep:
            return (
                f"the stand-in runs in lockstep and publishes {self._clock}, this controller in "
                "real time: set use_sim_time: true for all nodes, or pace: real_time for the "
                "stand-in"
            )
        if lockstep and self._node.get_parameter("use_sim_time").value and not published:
            return (
                f"no node publishes {self._clock}, and this controller follows simulated time: set "
                "pace: lockstep for the stand-in, or use_sim_time: false for all nodes"
            )
        return ""

    def intruder(self) -> str | None:
        """As `stranger`, but a publisher whose name is not discovered yet has until the next call.

        The name of a node arrives milliseconds after its topics.
        """
        unnamed, self._unnamed = self._unnamed, self._stranger() == UNNAMED
        return None if self._unnamed and not unnamed else self.stranger()

    def _stranger(self) -> str | None:
        if not self._simulated:
            return None
        names = {each.node_name for each in self._node.get_publishers_info_by_topic(self._topic)}
        return min(names - {STAND_IN}, default=None)
