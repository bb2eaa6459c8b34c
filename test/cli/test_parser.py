# SPDX-License-Identifier: Apache-2.0
"""A misspelt word is refused with a suggestion of the nearest valid word."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from wam_power_ros import __version__
from wam_power_ros.cli import main


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main.main(words)
    assert ended.value.code == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["lern"], "did you mean 'learn'?"),
        (["learn", "--sesion", "x"], "--sesion; did you mean '--session'?"),
        (["bags", "lst"], "did you mean 'list'?"),
        (["run", "torque_controler"], "did you mean 'torque_controller'?"),
        (["teach", "--demonstrations", "0"], "0 must be at least 1"),
        (["learn", "--trials", "0"], "--trials: 0 must be at least 1"),
        (["learn", "--seed", "-3"], "-3 must be at least 0"),
        (["learn", "--seed", "x"], "'x' is not a whole number"),
    ],
)
def test_a_wrong_word_or_number_is_refused_with_the_valid_ones(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in refused(capsys, *words)


def test_a_word_unlike_every_valid_one_gets_no_suggestion(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert "did you mean" not in refused(capsys, "quux")


def test_options_of_a_node_are_left_to_the_node() -> None:
    options = main._parser().parse_args(["run", "learner", "--ros-args", "-p", "seed:=1"])
    assert options.rest == ["--ros-args", "-p", "seed:=1"]


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main.main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"wam_power_ros {__version__}\n"


def test_stand_ins_without_a_set_up_are_refused(refusal: Callable[..., str]) -> None:
    for command in (["learn"], ["teach"], ["replay", "bag"], ["config"]):
        assert "everything is simulated already" in refusal(*command, "--simulate")


def test_the_shell_completes_commands(tmp_path: Path) -> None:
    pytest.importorskip("argcomplete")
    answer = tmp_path / "answer"
    words = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "COMP_LINE": "wam-power rep",
        "COMP_POINT": "13",
        "_ARGCOMPLETE_IFS": "\n",
    }
    command = [sys.executable, "-c", "from wam_power_ros.cli.main import main; main()"]
    subprocess.run(command, env=os.environ | words, timeout=60, check=True)
    assert answer.read_text().split() == ["report", "replay"]


@pytest.mark.parametrize("words", [[], ["bags"]])
def test_a_name_without_a_command_prints_the_commands(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(words) == 0
    assert "COMMAND" in capsys.readouterr().out


def test_no_command_waits_for_libraries_that_only_measuring_an_arm_needs() -> None:
    code = "import sys, wam_power_ros.cli.main; print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    slow = ("scipy.signal", "scipy.optimize", "scipy.stats", "mujoco", "matplotlib")
    assert not set(slow) & set(said.stdout.split())
