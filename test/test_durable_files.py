# SPDX-License-Identifier: Apache-2.0
"""Files are replaced atomically and flushed to disk before the old one is removed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from disk_flushes import record_flushes

from wam_power_ros import durable_files


def test_a_file_is_replaced_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "policy.json"
    for text in ("old", "new, with \N{GREEK SMALL LETTER TAU}"):
        durable_files.replace(path, text)
        assert path.read_text(encoding="utf-8") == text
    assert list(tmp_path.iterdir()) == [path]


def test_a_disk_that_refuses_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "policy.json"
    durable_files.replace(path, "old")

    def refuse(_: int) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OSError, match="disk full"):
        durable_files.replace(path, "new")
    assert path.read_text() == "old"


def test_the_text_is_flushed_before_the_rename_and_the_folder_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "policy.json"
    durable_files.replace(path, "old")
    part = tmp_path / ".policy.json.part"

    def texts() -> list[str]:
        return [each.read_text() for each in (path, part) if each.exists()]

    flushed = record_flushes(monkeypatch, texts)
    durable_files.replace(path, "new")
    assert flushed == [(part, ["old", "new"]), (tmp_path, ["new"])]


@pytest.mark.parametrize("name", ["", "policy.json"])
def test_a_file_and_a_folder_can_be_flushed_and_nothing_stays_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / "policy.json").write_text("text")
    before = set(os.listdir("/proc/self/fd"))
    flushed = record_flushes(monkeypatch, lambda: None)
    durable_files.sync(tmp_path / name)
    assert flushed == [(tmp_path / name, None)]
    assert set(os.listdir("/proc/self/fd")) == before
