# SPDX-License-Identifier: Apache-2.0
"""Entries of the nodes' logs are passed on; a long activity prints progress messages."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from wam_power_ros.cli import node_log
from wam_power_ros.cli.node_log import LogEntry, NodeLogs, progress_messages


def test_new_whole_lines_of_a_log_are_passed_on_once(tmp_path: Path) -> None:
    log = tmp_path / "torque_controller.log"
    log.write_text("[INFO] [1.5] [torque_controller]: of another day\n")
    logs = NodeLogs(tmp_path)
    with log.open("a") as file:
        file.write("[ERROR] [2.5] [torque_controller]: fault (jump): joint 3\nTraceback\n[WARN] [")
    assert list(logs.new()) == [LogEntry("ERROR", "torque_controller: fault (jump): joint 3")]
    with log.open("a") as file:
        file.write("3.5] [torque_controller]: half a line\n")
    (tmp_path / "learner.log").write_text("[INFO] [4.0] [learner]: begun\n")
    assert [entry.text for entry in logs.new()] == [
        "learner: begun",
        "torque_controller: half a line",
    ]
    assert list(logs.new()) == []


def test_long_activities_print_progress_and_short_ones_nothing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with progress_messages("short"):
        pass
    assert capsys.readouterr().out == ""
    monkeypatch.setattr(node_log, "MESSAGE_PERIOD", 0.01)
    printed = ""
    with progress_messages("writing the report"):
        while "writing the report, 0 s" not in printed:
            time.sleep(0.01)
            printed += capsys.readouterr().out
    capsys.readouterr()
    time.sleep(0.05)
    assert capsys.readouterr().out == ""
