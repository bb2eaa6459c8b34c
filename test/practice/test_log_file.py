# SPDX-License-Identifier: Apache-2.0
"""Session log: lines are kept in order, and a log that lost some is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from toss_task import some_records

from wam_power_ros.practice.log_file import LogFile, read_lines


def test_what_was_appended_is_there_when_it_is_opened_again(tmp_path: Path) -> None:
    records = some_records(3)
    log = LogFile(tmp_path)
    for record in records[:2]:
        log.append(record)
    log.close()
    again = LogFile(tmp_path)
    again.append(records[2])
    again.close()
    assert read_lines(tmp_path)[0] == again.lines == records


def test_a_line_out_of_order_is_refused(tmp_path: Path) -> None:
    first, second = some_records(2)
    log = LogFile(tmp_path)
    with pytest.raises(ValueError, match="rollout 2 cannot follow rollout 0"):
        log.append(second)
    log.append(first)
    log.close()
    assert read_lines(tmp_path)[0] == [first]


def test_a_log_that_is_shorter_than_was_acknowledged_is_not_opened(tmp_path: Path) -> None:
    log = LogFile(tmp_path)
    for record in some_records(2):
        log.append(record)
    log.close()
    path = tmp_path / "rollouts.jsonl"
    path.write_bytes(path.read_bytes().split(b"\n")[0] + b"\n")
    with pytest.raises(ValueError, match=r"2 rollouts in .* were acknowledged"):
        LogFile(tmp_path)
