# SPDX-License-Identifier: Apache-2.0
"""Terminal output and input."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path

import pytest

from wam_power_ros.console.prompt import ask, cue, show


@pytest.mark.parametrize(("typed", "answered"), [("\n", True), ("yes\n", True), ("", False)])
def test_a_question_is_answered_by_enter_and_not_by_a_closed_input(
    typed: str,
    answered: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(typed))
    assert ask("Press Enter: ") is answered
    assert capsys.readouterr() == ("", "Press Enter: ")  # a pipe gets results only


def test_a_line_is_written_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        flushed = 0

        def flush(self) -> None:
            self.flushed = len(self.getvalue())

    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    show("one of three")
    assert terminal.getvalue() == "one of three\n"
    assert terminal.flushed == len("one of three\n")


def test_a_cue_rings_and_is_spoken_where_a_speech_program_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    cue(True, "recording")
    assert capsys.readouterr().err == "\a"
    spoken = tmp_path / "spoken"
    os.mkfifo(spoken)
    speaker = tmp_path / "espeak"
    speaker.write_text(f'#!/bin/sh\necho "$1" > {spoken}\n')
    speaker.chmod(0o755)
    cue(False, "nothing")
    cue(True, "recorded")
    assert spoken.read_text() == "recorded\n"
