# SPDX-License-Identifier: Apache-2.0
"""Configure and activate the torque controller of a real arm, after a person has agreed to it.

The controller refuses without recent joint states, or without real-time scheduling: its reason is
printed and the request is repeated, until it is active or a person ends this.
"""

from __future__ import annotations

from lifecycle_msgs.msg import Transition

from wam_power_ros.client.link import Link
from wam_power_ros.client.reports import ControllerReports
from wam_power_ros.console.prompt import show
from wam_power_ros.control.modes import PASSIVE_MODES, Mode

CHANGE_STATE = "torque_controller/change_state"  # service
UNCONFIGURED = "unconfigured"  # mode of a controller in its diagnostics
REPORT_TIMEOUT = 2.0  # [s of wall time] for the reason of a refusal, reported once a second


def activate(link: Link) -> None:
    """Repeat the two transitions of the controller until it is active.

    Raises:
        ServiceError: The controller does not appear.
    """
    configure, shown = Transition.TRANSITION_CONFIGURE, ""
    reports = ControllerReports(link)
    for transition in (configure, Transition.TRANSITION_ACTIVATE):
        while not _changed(link, transition):
            seen = reports.count
            link.until(lambda: reports.count > seen, timeout=REPORT_TIMEOUT)  # noqa: B023
            if reports.mode and reports.mode not in {UNCONFIGURED, Mode.INACTIVE.value}:
                return  # a person has activated it meanwhile
            if transition is configure and reports.mode in PASSIVE_MODES:
                break
            if (reason := reports.refusal or reports.text) != shown:
                show(f"Not active yet: {reason}")
                shown = reason


def _changed(link: Link, transition: int) -> bool:
    answer = link.call(CHANGE_STATE, Transition(id=transition))
    return answer is not None and answer.success
