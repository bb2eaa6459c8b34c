# SPDX-License-Identifier: Apache-2.0
"""Errors of `wam-power view`; `test/view` tests the page itself."""

from __future__ import annotations

import fcntl
from collections.abc import Callable
from pathlib import Path

import pytest

from wam_power_ros.cli import commands


def test_a_session_that_is_being_taught_is_waited_for(
    tmp_path: Path, refusal: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("viser", reason="no viser")
    assert "typo holds no session" in refusal("view", "typo")
    folder, slept = tmp_path / "s", []
    (folder / "logs").mkdir(parents=True)
    lock = (folder / "logs" / ".lock").open("a")
    fcntl.flock(lock, fcntl.LOCK_EX)

    def sleep(seconds: float) -> None:  # its launcher ends
        slept.append(seconds)
        lock.close()

    monkeypatch.setattr(commands.time, "sleep", sleep)
    text = refusal("view", "s")
    assert "s is being taught; the page opens with its session" in text
    assert "has ended before its session began" in text and slept
