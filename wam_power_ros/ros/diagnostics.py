# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node as a message."""

from __future__ import annotations

from collections.abc import Mapping

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

LEVELS = {
    "ok": DiagnosticStatus.OK,
    "warn": DiagnosticStatus.WARN,
    "error": DiagnosticStatus.ERROR,
    "stale": DiagnosticStatus.STALE,
}


def diagnostics_message(
    now: Time, name: str, hardware_id: str, level: str, text: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Message with one status (REP-107).

    Args:
        now: Stamp.
        name: Name of node and component, as in "learner: session".
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
