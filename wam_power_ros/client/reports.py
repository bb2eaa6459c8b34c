# SPDX-License-Identifier: Apache-2.0
"""Newest report of the controller, which it publishes in its diagnostics once a second."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from wam_power_ros.client.link import Link
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.ros import diagnostics, interface


class ControllerReports:
    """Mode, summary, last refusal and id of the last stop by a person; "" for none, or before."""

    def __init__(self, link: Link) -> None:
        self._namespace = link.node.get_namespace()
        self.count = 0
        self.mode = self.text = self.refusal = self.last_stop = ""
        self.fault: Fault | None = None
        qos = interface.STATE_OUT
        link.listen(DiagnosticArray, interface.DIAGNOSTICS, self._on_report, qos)

    def _on_report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = diagnostics.of_controller(self._namespace, status)
            if values is None:
                continue
            kinds = {kind.value: kind for kind in FaultKind}
            kind = kinds.get(values[diagnostics.FAULT_KIND], FaultKind.SOFTWARE)
            failed = status.level == DiagnosticStatus.ERROR
            self.fault = Fault(kind, status.message) if failed else None
            self.mode, self.text = values.get("mode", ""), status.message
            self.refusal = values.get("last refusal", "")
            self.last_stop = values.get(diagnostics.LAST_STOP, "")
            self.count += 1
