# SPDX-License-Identifier: Apache-2.0
"""Log and diagnostics of the torque controller; the test replaces the preparation process."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import pytest
from conftest import Probe
from played_arm import HOME

from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.nodes.controller_report import Condition, ControllerReport
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import share
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.ros.scheduling import Granted

PARAMS = TorqueControllerParams.of_setup(overlay.of_files([]))
URDF = share("urdf/wam7.urdf").read_text()
STILL = Fault(FaultKind.STAMPS, "stamps stand")
UNCONFIGURED = Condition(
    core=None,
    fault=None,
    undescribed="",
    autostart=False,
    active=False,
    missing_state="no joint state",
    granted=Granted("granted", "granted"),
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

    def report(self, _: int, *of: object) -> None:
        """Keep name, device, level, text and values of the diagnostics."""
        self.reports.append(of)

    def take(self) -> list[tuple[str, str]]:
        """Log entries since the last call."""
        logged, self.logged = self.logged, []
        return logged


@pytest.fixture
def beside() -> Preparation:
    return Preparation()


@pytest.fixture
def report(probe: Probe, beside: Preparation) -> ControllerReport:
    return ControllerReport(probe.node, PARAMS, beside)


def active(fault: Fault | None = None) -> Condition:
    core = PARAMS.controller(URDF, fault)
    if fault is None:
        core.step(2_000_000, HOME, 0.0 * HOME)
        core.hold()
    return dataclasses.replace(
        UNCONFIGURED, core=core, fault=fault, undescribed=None, active=True, missing_state=None
    )


def test_each_mode_and_fault_and_its_reset_are_logged_once(
    report: ControllerReport, beside: Preparation
) -> None:
    held, still = active(), active(STILL)
    for condition in (held, held):
        report.log_changes(condition)
    assert beside.take() == [("info", "mode hold")]
    for condition in (still, still):
        report.log_changes(condition)
    fault = ("error", f"fault ({FaultKind.STAMPS.value}): stamps stand")
    assert beside.take() == [fault, ("info", "mode fault")]
    for condition in (held, held):
        report.log_changes(condition)
    assert beside.take() == [("info", "the fault was reset"), ("info", "mode hold")]


def test_another_fault_in_the_place_of_one_is_logged(
    report: ControllerReport, beside: Preparation
) -> None:
    report.log_changes(active(STILL))
    beside.take()
    report.log_changes(active(Fault(FaultKind.SOFTWARE, "a mistake")))
    assert beside.take() == [("error", f"fault ({FaultKind.SOFTWARE.value}): a mistake")]


def test_what_a_person_is_waited_for_is_logged_step_by_step(
    report: ControllerReport, beside: Preparation
) -> None:
    described = dataclasses.replace(UNCONFIGURED, undescribed=None)
    configured = dataclasses.replace(described, core=PARAMS.controller(URDF))
    fit = dataclasses.replace(configured, missing_state=None)
    for condition in (UNCONFIGURED, described, configured, fit, active()):
        report.log_changes(condition)
    waiting = [text for _, text in beside.logged if text.startswith("waiting for ")]
    assert waiting == [
        "waiting for the robot description on /robot_description",
        "waiting for ros2 lifecycle set /probe configure",
        "waiting for joint states on /joint_states (no joint state)",
        "waiting for ros2 lifecycle set /probe activate",
    ]


def test_a_velocity_topic_without_messages_is_named_in_the_log(
    report: ControllerReport, beside: Preparation
) -> None:
    configured = dataclasses.replace(
        UNCONFIGURED,
        undescribed=None,
        core=PARAMS.controller(URDF),
        missing_state="no joint velocity on wam/velocity within the last second",
    )
    report.log_changes(configured)
    assert "no joint velocity on wam/velocity" in beside.logged[-1][1]


def test_a_controller_that_starts_itself_waits_for_no_person(
    report: ControllerReport, beside: Preparation
) -> None:
    described = dataclasses.replace(UNCONFIGURED, undescribed=None, autostart=True)
    fit = dataclasses.replace(described, core=PARAMS.controller(URDF), missing_state=None)
    for condition in (described, fit):
        report.log_changes(condition)
    assert [text for _, text in beside.logged] == ["mode unconfigured", "mode inactive"]


def test_refusals_are_logged_and_counted_by_what_was_refused(
    report: ControllerReport, beside: Preparation
) -> None:
    report.refuse("policy", "too stiff")
    report.refuse("policy", "too large")
    report.refuse("joint state", "six joints")
    assert beside.logged[0] == ("warning", "policy refused: too stiff")
    report.publish(active(), {}, "")
    values = beside.reports[-1][-1]
    assert (values["refused: policy"], values["refused: joint state"]) == (2, 1)
    assert values["last refusal"] == "joint state refused: six joints"


def test_a_refusal_is_a_warning_for_one_second_and_remembered(
    report: ControllerReport, beside: Preparation
) -> None:
    report.refuse("policy", "too stiff")
    for _ in range(2):
        report.publish(active(), {}, "")
    assert [each[2:4] for each in beside.reports] == [
        ("warn", "policy refused: too stiff"),
        ("ok", "hold"),
    ]
    assert beside.reports[-1][-1]["last refusal"] == "policy refused: too stiff"


def test_a_callback_that_failed_is_named_with_where_innermost_first(
    report: ControllerReport, beside: Preparation
) -> None:
    def inner() -> None:
        raise KeyError("x")

    try:
        inner()
    except KeyError as error:
        report.failed(error)
    severity, text = beside.logged[-1]
    assert severity == "warning"
    assert text.startswith(f"callback refused: KeyError('x') at {__file__}:")
    first, second = text.split(" < ")
    assert first.endswith(" inner")
    assert second.endswith(" test_a_callback_that_failed_is_named_with_where_innermost_first")


def test_what_is_worst_is_the_summary(probe: Probe, beside: Preparation) -> None:
    params = PARAMS.model_copy(update={"realtime_priority": 60})
    report = ControllerReport(probe.node, params, beside)
    held = active()
    slow = dataclasses.replace(held, granted=Granted("refused", "granted"))
    silent = dataclasses.replace(slow, missing_state="no joint state")
    unasked = dataclasses.replace(held, active=False)
    still = dataclasses.replace(active(STILL), missing_state="no joint state", granted=slow.granted)
    expected = [
        (still, "9 % missed", ("error", "stamps stand")),
        (silent, "9 % missed", ("warn", "no joint state")),
        (unasked, "9 % missed", ("warn", "not active")),
        (slow, "9 % missed", ("warn", "9 % missed")),
        (slow, "", ("warn", "hold; no real-time scheduling")),
        (held, "", ("ok", "hold")),
    ]
    for condition, overload, summary in expected:
        report.publish(condition, {}, overload)
        assert beside.reports[-1][2:4] == summary


def test_a_machine_that_need_not_be_fast_is_no_warning(probe: Probe, beside: Preparation) -> None:
    params = PARAMS.model_copy(update={"realtime_priority": 0})
    report = ControllerReport(probe.node, params, beside)
    report.publish(dataclasses.replace(active(), granted=Granted()), {}, "")
    assert beside.reports[-1][2:4] == ("ok", "hold")


def test_the_diagnostics_name_the_loop_its_fault_and_its_figures(
    report: ControllerReport, beside: Preparation
) -> None:
    report.publish(UNCONFIGURED, {"cycles": "0"}, "")
    name, device, _, _, values = beside.reports[-1]
    assert (name, device) == ("probe: loop", PARAMS.hardware_id)
    expected = {"mode": "unconfigured", "policy": "", "fault kind": "", "cycles": "0"}
    assert expected.items() <= values.items()
    assert (values["locked memory"], values["preparation processes"]) == ("granted", 1)
    faulted = active(STILL)
    faulted.core.refuse_state()
    report.publish(faulted, {"cycles": "500"}, "")
    values = beside.reports[-1][-1]
    assert (values["mode"], values["fault kind"]) == ("fault", FaultKind.STAMPS.value)
    assert values["rejected"] == 1
