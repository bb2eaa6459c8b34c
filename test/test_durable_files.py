# SPDX-License-Identifier: Apache-2.0
"""Files are replaced atomically and flushed to disk before the old one is removed."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from disk_flushes import record_flushes

from wam_power_ros import durable_files


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
    durable_files.replace(path, "new, with \N{GREEK SMALL LETTER TAU}")
    new = path.read_text(encoding="utf-8")
    assert new.startswith("new, with \N{GREEK SMALL LETTER TAU}")
    assert flushed == [(part, ["old", new]), (tmp_path, [new])]
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("number", "remedy"),
    [(errno.ENOSPC, "free some space"), (errno.EROFS, "read-only"), (errno.EACCES, "not yours")],
)
def test_an_error_of_the_disk_has_its_file_and_a_remedy(
    number: int, remedy: str, tmp_path: Path
) -> None:
    file = tmp_path / "rollouts.jsonl"
    with pytest.raises(OSError, match="rollouts") as caught, durable_files.naming(file):
        raise OSError(number, os.strerror(number))
    text = durable_files.explained(caught.value)
    assert text.startswith(f"{file}: {os.strerror(number)}; ") and remedy in text
    assert "Errno" not in text


def test_the_file_that_was_meant_is_named_and_any_other_error_is_told_as_it_is(
    tmp_path: Path,
) -> None:
    with pytest.raises(OSError) as caught:
        durable_files.replace(tmp_path / "missing" / "report.html", "")
    file = tmp_path / "missing" / "report.html"
    assert durable_files.explained(caught.value) == f"{file}: No such file or directory"
    assert durable_files.explained(OSError("gone")) == "gone"


@pytest.mark.parametrize("name", ["a\x1b[31mb", "a\tb", "a\udc80b"])
def test_a_name_with_control_characters_is_escaped_and_refused(name: str) -> None:
    assert durable_files.printable(name).isprintable()
    with pytest.raises(ValueError, match="control characters") as caught:
        durable_files.check_name(Path(name))
    assert str(caught.value).isprintable()
    durable_files.check_name(Path(plain := "Übung 1_é (2).mcap"))
    assert durable_files.printable(plain) == plain
