# SPDX-License-Identifier: Apache-2.0
"""Variables of ROS, DDS and Python: with each a node runs, or one line names it and the remedy."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest
from conftest import ROOT, Process, Processes

from wam_power_ros.cli import main
from wam_power_ros.cli.node_log import LOG_LINE
from wam_power_ros.cli.processes import LOG_FORM
from wam_power_ros.ros import network

RUNS = ""  # nothing is said about the variable
ASCII = {"PYTHONIOENCODING": "ascii", "LANG": "C", "LC_ALL": "C"}
NARROW = {"TERM": "dumb", "COLUMNS": "20"}
PROFILE = network.FAST_DDS_2.variable
# Variables; what a line says beside their names. `DIR` is a folder of the test.
TABLE: tuple[tuple[dict[str, str], str], ...] = (
    ({"ROS_LOCALHOST_ONLY": "1"}, RUNS),
    ({"ROS_LOCALHOST_ONLY": "0", "ROS_STATIC_PEERS": "127.0.0.1"}, RUNS),
    ({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp", "CYCLONEDDS_URI": "file://DIR/none.xml"}, RUNS),
    ({"RMW_IMPLEMENTATION": "rmw_none_cpp"}, "not installed; apt install ros-jazzy-rmw-none-cpp"),
    ({"ROS_DOMAIN_ID": "233"}, "is not a whole number from 0 to 232"),
    ({"ROS_DISCOVERY_SERVER": "127.0.0.1:11811"}, RUNS),
    ({"ROS_STATIC_PEERS": "no.such.host.invalid"}, "is no address or known host"),
    ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LAB"}, "is not one of LOCALHOST, SUBNET, OFF"),
    ({PROFILE: "DIR/none.xml"}, "there is no such file: correct it, or unset"),
    ({"PYTHONOPTIMIZE": "2", "PYTHONWARNINGS": "error", "PYTHONHASHSEED": "7"} | ASCII, RUNS),
    ({"ROS_LOG_DIR": "DIR/file/logs"}, "no log can be written there (Not a directory)"),
    ({"RCUTILS_LOGGING_USE_STDOUT": "yes"}, "is not 0 or 1: correct it, or unset"),
    ({"RCUTILS_LOGGING_BUFFERED_STREAM": "1", "RCUTILS_COLORIZED_OUTPUT": "1"}, RUNS),
    ({"RCUTILS_CONSOLE_OUTPUT_FORMAT": "{message}", "NO_COLOR": "1"} | NARROW, RUNS),
)
# Not from the process that forks: Python reads some of them at its start.
TRACKER = "from wam_power_ros.entry import pancake_tracker; raise SystemExit(pancake_tracker())"


def started(processes: Processes, folder: Path, variables: dict[str, str]) -> Process:
    """A tracker with these variables."""
    given = {name: value.replace("DIR", str(folder)) for name, value in variables.items()}
    return processes.start([sys.executable, "-c", TRACKER], **given)


@pytest.mark.parametrize(
    ("variables", "said"), TABLE, ids=["=".join(next(iter(row.items()))) for row, _ in TABLE]
)
def test_a_node_runs_or_one_line_names_the_variable_and_the_remedy(
    variables: dict[str, str], said: str, processes: Processes, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    for name in (network.RANGE, PROFILE):
        processes.environment.pop(name, None)
    process = started(processes, tmp_path, variables)
    output = lambda: processes.output(process)  # noqa: E731
    if said == RUNS:
        end = time.monotonic() + 120.0
        while "waiting for frames of the pancake" not in output():
            assert process.poll() is None and time.monotonic() < end, output()
            time.sleep(0.05)
        assert processes.end(process) == 0
        assert "Traceback" not in output()
        return
    assert process.wait(120.0) == 2
    (line,) = [line for line in output().splitlines() if said in line]
    assert next(iter(variables)) in line
    assert len(output().splitlines()) == 1, output()


def test_fifteen_variables_or_more_are_in_the_table_and_none_else_is_said() -> None:
    assert len({name for row, _ in TABLE for name in row}) >= 15


def test_a_session_reads_the_logs_of_its_nodes_whatever_form_the_terminal_asks_for() -> None:
    form = LOG_FORM["RCUTILS_CONSOLE_OUTPUT_FORMAT"]
    line = form.format(severity="INFO", time="1795899277.302561418", name="learner", message="m")
    assert LOG_LINE.match(line)


@pytest.mark.parametrize("columns", ["1", "20", "80", "no number"])
def test_the_help_is_whole_at_any_width(
    columns: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    assert main.main([]) == 0
    words = capsys.readouterr().out.split()
    assert {name for names in main.HEADINGS.values() for name in names} <= {*words}


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
