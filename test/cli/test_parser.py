# SPDX-License-Identifier: Apache-2.0
"""A misspelt word is refused with a suggestion of the nearest valid word."""

from __future__ import annotations

import os
import re
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


def test_an_option_cannot_be_abbreviated_but_is_suggested(
    capsys: pytest.CaptureFixture[str],
) -> None:
    message = refused(capsys, "learn", "--demonstration", "3")
    assert "unknown option --demonstration; did you mean '--demonstrations'?" in message


def test_the_help_begins_with_five_commands_and_has_every_other_under_one_heading(
    capsys: pytest.CaptureFixture[str],
) -> None:
    listed = [name for names in main.HEADINGS.values() for name in names]
    (commands,) = (
        action.choices for action in main._parser()._actions if isinstance(action.choices, dict)
    )
    assert sorted(listed) == sorted(commands)
    assert listed[:5] == ["learn", "teach", "replay", "view", "doctor"]
    assert main.main([]) == 0
    shown = re.findall(r"^  ([a-z-]+)  ", capsys.readouterr().out, re.MULTILINE)
    assert [name for name in shown if name in listed] == listed


@pytest.mark.parametrize(
    ("what", "name", "says"),
    [
        ("tasks", "reach", "past an obstacle"),
        ("learners", "cma_es", "CMA-ES"),
        ("presets", "flip paper", "learner power"),
        ("set-ups", "ur", "Universal Robots"),
    ],
)
def test_names_are_listed_a_line_each_with_what_they_are(
    what: str, name: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["list", what]) == 0
    rows = [re.split("  +", line, maxsplit=1) for line in capsys.readouterr().out.splitlines()]
    assert all(text.strip() for _, text in rows)
    assert says in dict(rows)[name]


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["--task", "flop"], "flip"),
        (["--learner", "pwoer"], "power"),
        (["--preset", "papr"], "paper"),
        (["--config", "geodud"], "geodude"),
    ],
)
def test_a_mistyped_name_is_met_with_the_nearest_one(
    words: list[str], meant: str, refusal: Callable[..., str]
) -> None:
    assert f"did you mean '{meant}'?" in refusal("learn", "--session", "s", *words)


def test_set_up_and_task_are_said_the_same_way_wherever_there_is_one() -> None:
    (commands,) = (
        action.choices for action in main._parser()._actions if isinstance(action.choices, dict)
    )
    task = {name for name, each in commands.items() if "--task" in each._option_string_actions}
    setup = {name for name, each in commands.items() if "--config" in each._option_string_actions}
    run = {"learn", "teach", "replay", "run-policy", "compare"}
    assert task == {*run, "score", "config", "doctor"}
    assert setup == {*task, "commission"} - {"score"}
    for name in (*task, *setup):
        places = [action.dest for action in commands[name]._actions if not action.option_strings]
        assert not {"task", "config"} & {*places}


def test_a_task_may_be_the_class_of_a_file_and_a_wrong_one_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "from wam_power_ros.tasks.reach.task import Reach\nclass Mine(Reach):\n    name = 'mine'\n"
    )
    for task in (f"{file}:Mine", "wam_power_ros.tasks.reach.task:Reach"):
        assert main.main(["config", "--task", task]) == 0
        assert "obstacle" in capsys.readouterr().out or "reach" in capsys.readouterr().out
    file.write_text("1 / 0\n")
    other = file.rename(tmp_path / "broken.py")
    assert "cannot be imported: division by zero" in refused(
        capsys, "config", "--task", f"{other}:Mine"
    )
    assert "cannot be imported" in refused(capsys, "config", "--task", "no.module:Mine")
