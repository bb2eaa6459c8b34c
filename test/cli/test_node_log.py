# SPDX-License-Identifier: Apache-2.0
"""Entries of the nodes' logs are passed on."""

from __future__ import annotations

from pathlib import Path

from wam_power_ros.cli.processes import NodeLogs


def test_new_whole_lines_of_a_log_are_passed_on_once(tmp_path: Path) -> None:
    log = tmp_path / "torque_controller.log"
    log.write_text("[INFO] [1.5] [torque_controller]: of another day\n")
    logs = NodeLogs(tmp_path)
    with log.open("a") as file:
        file.write("[ERROR] [2.5] [torque_controller]: fault (jump): joint 3\nTraceback\n[WARN] [")
    assert list(logs.new()) == [("torque_controller: fault (jump): joint 3", True)]
    with log.open("a") as file:
        file.write("3.5] [torque_controller]: half a line\n")
    (tmp_path / "learner.log").write_text("[INFO] [4.0] [learner]: begun\n")
    texts = [text for text, _ in logs.new()]
    assert texts == ["learner: begun", "torque_controller: half a line"]
    assert list(logs.new()) == []
