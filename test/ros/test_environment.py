# SPDX-License-Identifier: Apache-2.0
"""Variables of ROS, DDS and Python: with each a node runs, or one line names it and the remedy."""

from __future__ import annotations

import sys
import time

import pytest
from conftest import ROOT, Process, Processes

from wam_power_ros.cli.processes import LOG_FORM, LOG_LINE
from wam_power_ros.ros import network

PROFILE = network.FAST_DDS_2.variable
NARROW = {"TERM": "dumb", "COLUMNS": "20", "LANG": "C", "LC_ALL": "C", "PYTHONIOENCODING": "ascii"}
STRICT = {"PYTHONOPTIMIZE": "2", "PYTHONWARNINGS": "error", "PYTHONHASHSEED": "7"}
FORM = {"RCUTILS_CONSOLE_OUTPUT_FORMAT": "{message}", "RCUTILS_LOGGING_BUFFERED_STREAM": "1"}
IGNORED = {"ROS_LOCALHOST_ONLY": "1", "CYCLONEDDS_URI": "file://none.xml"}
NAMED = (  # a variable, its value, and what a line says beside its name
    ("RMW_IMPLEMENTATION", "rmw_none_cpp", "not installed; apt install ros-jazzy-rmw-none-cpp"),
    (PROFILE, "none.xml", "there is no such file"),
)
# Not from the process that forks: Python reads some of them at its start.
TRACKER = "from wam_power_ros.entry import pancake_tracker; raise SystemExit(pancake_tracker())"


def started(processes: Processes, variables: dict[str, str]) -> Process:
    """A tracker with these variables."""
    for name in (network.RANGE, PROFILE):
        processes.environment.pop(name, None)
    return processes.start([sys.executable, "-c", TRACKER], **variables)


def test_a_node_runs_with_variables_that_change_nothing(processes: Processes) -> None:
    process = started(processes, {**IGNORED, **NARROW, **STRICT, **FORM})
    end = time.monotonic() + 120.0
    while "waiting for frames of the pancake" not in (output := processes.output(process)):
        assert process.poll() is None and time.monotonic() < end, output
        time.sleep(0.05)
    assert processes.end(process) == 0
    assert "Traceback" not in processes.output(process)


@pytest.mark.parametrize(("name", "value", "said"), NAMED, ids=[row[0] for row in NAMED])
def test_one_line_names_a_variable_with_which_no_node_can_run(
    name: str, value: str, said: str, processes: Processes
) -> None:
    process = started(processes, {name: value})
    assert process.wait(120.0) == 2
    (line,) = processes.output(process).splitlines()
    assert name in line and said in line


def test_a_range_of_discovery_that_is_none_is_refused() -> None:
    with pytest.raises(network.VariableError, match="LAB is not one of LOCALHOST, SUBNET, OFF"):
        network.check({network.RANGE: "LAB"})


def test_a_session_reads_the_logs_of_its_nodes_whatever_form_the_terminal_asks_for() -> None:
    form = LOG_FORM["RCUTILS_CONSOLE_OUTPUT_FORMAT"]
    line = form.format(severity="INFO", time="1795899277.302561418", name="learner", message="m")
    assert LOG_LINE.match(line)


def test_a_python_without_our_modules_is_named_with_what_it_misses_and_the_remedy(
    processes: Processes,
) -> None:
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); {TRACKER}"
    process = processes.start([sys.executable, "-I", "-S", "-c", code])
    assert process.wait(60.0) == 2
    (line,) = processes.output(process).splitlines()
    assert sys.executable in line
    assert "has no module " in line
    assert ".venv/bin/python -m colcon build" in line
