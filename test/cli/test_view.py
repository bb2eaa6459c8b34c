# SPDX-License-Identifier: Apache-2.0
"""Errors of `wam-power view`; `test/view` tests the page itself."""

from __future__ import annotations

import fcntl
import sys
from pathlib import Path

import pytest

from wam_power_ros.cli import commands, main


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main.main(["view", *arguments]) == 2
    return capsys.readouterr().err


def test_without_viser_it_says_how_to_install_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith("wam_power_ros.view")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "viser", None)
    assert refusal(capsys).endswith('pip install "wam_power_ros[view]"\n')


def test_a_session_that_is_being_taught_is_waited_for(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("viser", reason="no viser")
    assert "typo holds no session" in refusal(capsys, str(tmp_path / "typo"))
    folder, slept = tmp_path / "s", []
    (folder / "logs").mkdir(parents=True)
    lock = (folder / "logs" / ".lock").open("a")
    fcntl.flock(lock, fcntl.LOCK_EX)

    def sleep(seconds: float) -> None:  # its launcher ends
        slept.append(seconds)
        lock.close()

    monkeypatch.setattr(commands.time, "sleep", sleep)
    text = refusal(capsys, str(folder))
    assert "s is being taught; the page opens with its session" in text
    assert "has ended before its session began" in text and slept
    assert "recover" not in text
