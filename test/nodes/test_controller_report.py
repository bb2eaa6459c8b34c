# SPDX-License-Identifier: Apache-2.0
"""Log and diagnostics of the torque controller; the test replaces the preparation process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace

import pytest
from played_arm import HOME

from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.nodes.controller_report import Condition, ControllerReport
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import share
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.ros.scheduling import Granted

PARAMS = TorqueControllerParams.from_setup(overlay.from_files([]))
URDF = share("urdf/wam7.urdf").read_text()
STILL = Fault(FaultKind.STAMPS, "stamps stand")
UNCONFIGURED = Condition(
    core=None,
    fault=None,
    description_missing="",
    autostart=False,
    active=False,
    missing_state="no joint state",
    granted=Granted("granted", "granted"),
)
NODE = SimpleNamespace(
    get_name=lambda: "probe",
    get_logger=lambda: SimpleNamespace(name="probe"),
    get_fully_qualified_name=lambda: "/probe",
    resolve_topic_name=lambda name: f"/{name}",
    get_clock=lambda: SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=1)),
)


class Preparation:
    """Keeps log entries and diagnostics."""

    starts = 1

    def __init__(self) -> None:
        self.logged: list[tuple[str, str]] = []
        self.reports: list[tuple[str, str, str, str, Mapping[str, object]]] = []

    def log(self, severity: str, text: str) -> None:
        """Keep a log entry."""
        self.logged.append((severity, text))

    def report(self, _: int, values: Mapping[str, object], **status: str) -> None:
        """Keep name, device, level, text and values of the diagnostics."""
        self.reports.append((*status.values(), values))

    def take(self) -> list[tuple[str, str]]:
        """Log entries since the last call."""
        logged, self.logged = self.logged, []
        return logged


@pytest.fixture
def beside() -> Preparation:
    return Preparation()


@pytest.fixture
def report(beside: Preparation) -> ControllerReport:
    return ControllerReport(NODE, PARAMS, beside)


def active(fault: Fault | None = None) -> Condition:
    core = PARAMS.controller(URDF, fault)
    if fault is None:
        core.step(2_000_000, HOME, 0.0 * HOME)
        core.hold()
    return replace(
        UNCONFIGURED,
        core=core,
        fault=fault,
        description_missing=None,
        active=True,
        missing_state=None,
    )


def test_each_mode_and_fault_and_its_reset_are_logged_once(
    report: ControllerReport, beside: Preparation
) -> None:
    held, still = active(), active(STILL)
    mistake = replace(still, fault=Fault(FaultKind.SOFTWARE, "a mistake"))
    for condition, logged in (
        (held, [("info", "mode hold")]),
        (still, [("error", "fault (stamps): stamps stand"), ("info", "mode fault")]),
        (mistake, [("error", "fault (software): a mistake")]),
        (held, [("info", "the fault was reset"), ("info", "mode hold")]),
    ):
        for _ in range(2):
            report.log_changes(condition)
        assert beside.take() == logged


def test_a_node_that_was_shut_down_waits_for_its_end_alone(
    report: ControllerReport, beside: Preparation
) -> None:
    report.log_changes(replace(active(), active=False, finalized=True))
    assert beside.take()[-1] == ("info", "waiting for its end (Ctrl-C): it was shut down")


def test_refusals_are_counted_a_warning_for_one_second_and_remembered(
    report: ControllerReport, beside: Preparation
) -> None:
    for what, reason in (("policy", "stiff"), ("joint state", "six"), ("policy", "too large")):
        report.refuse(what, reason)
    assert beside.logged[0] == ("warning", "policy refused: stiff")
    for _ in range(2):
        report.publish(active(), {}, "")
    assert [each[2:4] for each in beside.reports] == [
        ("warn", "policy refused: too large"),
        ("ok", "hold"),
    ]
    values = beside.reports[-1][-1]
    assert (values["refused: policy"], values["refused: joint state"]) == (2, 1)
    assert values["last refusal"] == "policy refused: too large"


def test_what_is_worst_is_the_summary(beside: Preparation) -> None:
    report = ControllerReport(NODE, PARAMS.model_copy(update={"realtime_priority": 60}), beside)
    held = active()
    slow = replace(held, granted=Granted("refused", "granted"))
    silent = replace(slow, missing_state="no joint state")
    unasked = replace(held, active=False)
    still = replace(active(STILL), missing_state="no joint state", granted=slow.granted)
    for condition, overload, summary in (
        (still, "9 % missed", ("error", "stamps stand")),
        (silent, "9 % missed", ("warn", "no joint state")),
        (unasked, "9 % missed", ("warn", "not active")),
        (slow, "9 % missed", ("warn", "9 % missed")),
        (slow, "", ("warn", "hold; no real-time scheduling")),
        (held, "", ("ok", "hold")),
    ):
        report.publish(condition, {}, overload)
        assert beside.reports[-1][2:4] == summary
    need_not = PARAMS.model_copy(update={"realtime_priority": 0})
    ControllerReport(NODE, need_not, beside).publish(replace(held, granted=Granted()), {}, "")
    assert beside.reports[-1][2:4] == ("ok", "hold")
