# SPDX-License-Identifier: Apache-2.0
"""Terminal output and input."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from contextlib import suppress
from itertools import product
from types import SimpleNamespace
from typing import NoReturn

import numpy as np
import pytest
from conftest import lift
from rigid_arm import HOME, MODEL

from wam_power_ros.console import replay, run_policy
from wam_power_ros.console.prompt import let_go_after

T, Q = np.array([0.0, 1.0]), np.array([HOME, HOME])


@pytest.fixture(autouse=True)
def _enter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody presses Enter twice."""
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n\n"))


def test_a_person_supports_the_arm_before_it_is_let_go_however_a_movement_ended(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for person, ended in product((True, False), (KeyboardInterrupt, None)):
        with suppress(KeyboardInterrupt), let_go_after(person):
            if ended is not None:
                raise ended
        out, err = capsys.readouterr()  # a pipe gets results only
        assert ("Support the arm" in err) is person and not out


class Broken:
    """An arm that stops, and whose other services end in an error that nobody expects."""

    arm, link = MODEL, SimpleNamespace(log_period=0.0)

    def stop(self) -> None:
        """Succeed."""

    def __getattr__(self, name: str) -> NoReturn:
        raise RuntimeError(name)


each_command_that_moves_the_arm = pytest.mark.parametrize(
    "move",
    [
        lambda robot: replay.replay(robot, "bag", T, Q, 1.0, person=True),
        lambda robot: run_policy.run(robot, lift("lift"), None, 1, person=True),
    ],
    ids=["replay", "run-policy"],
)


@each_command_that_moves_the_arm
def test_support_is_asked_for_also_after_an_unexpected_error(
    move: Callable[[Broken], int], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(RuntimeError):
        move(Broken())
    assert "Support the arm" in capsys.readouterr().err


@each_command_that_moves_the_arm
def test_an_arm_does_not_move_where_nobody_can_answer(
    move: Callable[[Broken], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    with pytest.raises(ValueError, match="standard input is closed"):
        move(Broken())
