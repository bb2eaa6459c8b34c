# SPDX-License-Identifier: Apache-2.0
"""Configure and activate the torque controller of a real arm, after a person has agreed to it.

The controller refuses without recent joint states, or without real-time scheduling: its reason is
printed and the request is repeated, until it is active or a person ends this.
"""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports, which a signal may interrupt
    from wam_power_ros.entry import INTERRUPTED, start

    raise SystemExit(start("wam_power_ros.console.activation", INTERRUPTED))

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node

from wam_power_ros.console.prompt import show
from wam_power_ros.control.modes import PASSIVE_MODES, Mode
from wam_power_ros.ros import diagnostics, interface
from wam_power_ros.ros.node_runner import run_script
from wam_power_ros.ros.service_client import ServiceClient

CHANGE_STATE = "torque_controller/change_state"  # service
UNCONFIGURED = "unconfigured"  # mode of a controller in its diagnostics
REPORT_TIMEOUT = 2.0  # [s of wall time] for the reason of a refusal, reported once a second


class Activation(Node):
    """Requests the two transitions of the controller."""

    def __init__(self) -> None:
        super().__init__("activation")
        self._calls = ServiceClient(self)
        self._mode = self._reason = self._shown = ""
        self._reports = 0
        self.create_subscription(
            DiagnosticArray, interface.DIAGNOSTICS, self._on_report, interface.DIAGNOSTICS_QOS
        )

    def run(self) -> None:
        """Repeat the requests until the controller is active.

        Raises:
            ServiceError: The controller does not appear, or does not answer.
        """
        inactive = {UNCONFIGURED, Mode.INACTIVE.value}
        for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            while not self._change(transition):
                seen = self._reports
                self._calls.until(lambda: self._reports > seen, timeout=REPORT_TIMEOUT)  # noqa: B023
                if self._mode and self._mode not in inactive:
                    return  # a person has activated it meanwhile
                if transition is Transition.TRANSITION_CONFIGURE and self._mode in PASSIVE_MODES:
                    break
                if self._reason != self._shown:
                    show(f"Not active yet: {self._reason}")
                    self._shown = self._reason

    def _change(self, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        answer = self._calls.call(ChangeState, CHANGE_STATE, request)
        return answer is not None and answer.success

    def _on_report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = diagnostics.of_controller(self.get_namespace(), status)
            if values is not None:
                self._mode = values.get("mode", "")
                self._reason = values.get("last refusal", "") or status.message
                self._reports += 1


def main() -> int:
    """Run `python -m wam_power_ros.console.activation`."""
    return run_script(Activation, Activation.run)
