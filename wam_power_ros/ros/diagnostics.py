# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node as a message."""

from __future__ import annotations

from collections.abc import Mapping

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

LEVELS = {
    "ok": DiagnosticStatus.OK,
    "warn": DiagnosticStatus.WARN,
    "error": DiagnosticStatus.ERROR,
    "stale": DiagnosticStatus.STALE,
}


FAULT_KIND = "fault kind"  # value that the status of a controller has, and no other


def component(node: Node, part: str) -> str:
    """Name of a status on /diagnostics, which all arms share: `left/wam_sim: loop`."""
    return f"{node.get_fully_qualified_name().lstrip('/')}: {part}"


def of_controller(namespace: str, status: DiagnosticStatus) -> dict[str, str] | None:
    """Values of a status if it is that of the controller in a namespace, else None."""
    values = {each.key: each.value for each in status.values}
    above, _, node = status.name.partition(":")[0].rpartition("/")
    mine = FAULT_KIND in values and above == namespace.strip("/") and bool(node)
    return values if mine else None


def diagnostics_message(
    now: Time, name: str, hardware_id: str, level: str, text: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Message with one status (REP-107).

    Args:
        now: Stamp.
        name: Name of node and component, see `component`.
        hardware_id: Name of the device.
        level: One of `LEVELS`.
        text: Summary for a person.
        values: Values by name, written as text.
    """
    status = DiagnosticStatus(
        level=LEVELS[level],
        name=name,
        hardware_id=hardware_id,
        message=text,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )
    message = DiagnosticArray(status=[status])
    message.header.stamp = now
    return message
