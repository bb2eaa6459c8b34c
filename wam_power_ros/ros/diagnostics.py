# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node as a message."""

from __future__ import annotations

from collections.abc import Mapping

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from wam_power_ros.ros import interface

FAULT_KIND = "fault kind"  # key that only the status of a controller has
LAST_STOP = "last stop by a person"  # key of its id, "" before the first
# Key that only the status of a learner has: "plans", "practises", "paused", or what it waits for,
# the states of `client.rollouts.Awaited`.
LEARNER_STATE = "session state"


def component(node: Node, part: str) -> str:
    """Name of a status with the namespace, as all arms share /diagnostics: `left/wam_sim: loop`."""
    return f"{node.get_fully_qualified_name().lstrip('/')}: {part}"


def of_controller(namespace: str, status: DiagnosticStatus) -> dict[str, str] | None:
    """Values of the status of the controller in a namespace; None for any other status."""
    values = {each.key: each.value for each in status.values}
    parent, _, node = status.name.partition(":")[0].rpartition("/")
    matches = FAULT_KIND in values and parent == namespace.strip("/") and bool(node)
    return values if matches else None


def diagnostics_message(
    now: Time, name: str, hardware_id: str, level: str, text: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Message with one status (REP-107); `level` is "ok", "warn", "error" or "stale"."""
    status = DiagnosticStatus(
        level=getattr(DiagnosticStatus, level.upper()),
        name=name,
        hardware_id=hardware_id,
        message=text,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )
    message = DiagnosticArray(status=[status])
    message.header.stamp = now
    return message


class Diagnostics:
    """Publishes the status of a part of a node."""

    def __init__(self, node: Node, part: str, hardware_id: str) -> None:
        self._node, self._of = node, (component(node, part), hardware_id)
        topic, qos = interface.DIAGNOSTICS, interface.STATE_OUT
        self._publisher = node.create_publisher(DiagnosticArray, topic, qos)

    def publish(self, level: str, text: str, values: Mapping[str, object]) -> None:
        """Publish as `diagnostics_message` has it, with the time of the node."""
        now = self._node.get_clock().now().to_msg()
        self._publisher.publish(diagnostics_message(now, *self._of, level, text, values))
