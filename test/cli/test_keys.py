# SPDX-License-Identifier: Apache-2.0
"""Keys of the terminal during a session, pressed on a real pseudo-terminal."""

from __future__ import annotations

import os
import pty
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import Probe
from std_srvs.srv import Trigger

from wam_power_interfaces.srv import Pause
from wam_power_ros.cli.keys import HINT, passing_keys
from wam_power_ros.ros import interface


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Keyboard end of a terminal that is this process's standard input."""
    keyboard, screen = pty.openpty()
    monkeypatch.setattr(sys, "stdin", os.fdopen(screen))
    monkeypatch.setattr(os, "tcgetpgrp", lambda fd: os.getpgrp())
    yield keyboard
    os.close(keyboard)


def test_each_key_reaches_its_node_and_the_answer_is_shown(
    probe: Probe, domain_id: int, terminal: int
) -> None:
    asked: list[object] = []

    def serve(kind: type, name: str) -> None:
        def answer(request: object, response: object) -> object:
            asked.append(getattr(request, "pause", name))
            response.success, response.message = True, f"answer {len(asked)}"
            return response

        probe.node.create_service(kind, name, answer)

    reward, punish, stop = interface.LEARNER_REWARD, interface.LEARNER_PUNISH, interface.STOP
    for name in (reward, punish, stop):
        serve(Trigger, name)
    serve(Pause, interface.LEARNER_PAUSE)
    before = termios.tcgetattr(sys.stdin)
    with passing_keys(domain_id) as poll:
        assert poll() == HINT
        for number, (key, expected) in enumerate(
            (
                (b"xr", reward),
                (b"p", punish),
                (b" ", True),
                (b" ", True),
                (b"c", False),
                (b"s", stop),
            ),
            start=1,
        ):
            os.write(terminal, key)
            probe.until(lambda n=number: poll() == f"answer {n}", key.decode())
            assert asked[-1] == expected and len(asked) == number
    assert termios.tcgetattr(sys.stdin) == before


def test_without_a_terminal_nothing_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "input").write_text("r")
    monkeypatch.setattr(sys, "stdin", (tmp_path / "input").open())
    with passing_keys(None) as poll:
        assert poll() == "" and sys.stdin.read() == "r"
