# SPDX-License-Identifier: Apache-2.0
"""Options of the commands: wrong ones are refused with the valid ones."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from wam_power_ros.cli import main


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main.main(words)
    assert ended.value.code == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("teach --demonstrations 0", "0 must be at least 1"),
        ("learn --seed -3", "-3 must be at least 0"),
        ("learn --seed x", "'x' is not a whole number"),
        ("learn --demonstration 3", "unrecognized arguments: --demonstration 3"),
        ("run torque_controler", "torque_controller"),
        ("config --task no.module:Mine", "cannot be imported"),
    ],
)
def test_a_wrong_word_or_number_is_refused(
    words: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in refused(capsys, *words.split())


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("--task flop", "flip"),
        ("--learner pwoer", "power"),
        ("--preset papr", "paper"),
        ("--config geodud", "geodude"),
    ],
)
def test_a_mistyped_name_is_met_with_the_nearest_one(
    words: str, meant: str, refusal: Callable[..., str]
) -> None:
    assert f"did you mean '{meant}'?" in refusal("learn", "--session", "s", *words.split())


def test_stand_ins_without_a_set_up_are_refused(refusal: Callable[..., str]) -> None:
    for command in (["teach"], ["replay", "bag"]):
        assert "everything is simulated already" in refusal(*command, "--simulate")


def test_a_name_without_a_command_prints_the_commands(said: Callable[..., str]) -> None:
    for words in ((), ("bags",)):
        assert "COMMAND" in said(*words)


def test_no_command_waits_for_ros_or_libraries_that_only_measuring_an_arm_needs() -> None:
    code = "import sys, wam_power_ros.cli.main; print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    slow = ("scipy.signal", "scipy.optimize", "scipy.stats", "mujoco", "matplotlib")
    ros = ("rclpy", "std_srvs", "wam_power_interfaces")
    assert not {*slow, *ros} & set(said.stdout.split())


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
    what: str, name: str, says: str, said: Callable[..., str]
) -> None:
    rows = [re.split("  +", line, maxsplit=1) for line in said("list", what).splitlines()]
    assert all(text.strip() for _, text in rows)
    assert says in dict(rows)[name]


def test_a_task_may_be_the_class_of_a_file_and_a_broken_one_is_named(
    tmp_path: Path, said: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text(
        "from wam_power_ros.tasks.reach.task import Reach\nclass Mine(Reach):\n    name = 'mine'\n"
    )
    for task in ("mine.py:Mine", "wam_power_ros.tasks.reach.task:Reach"):
        text = said("config", "--task", task)
        assert "obstacle" in text or "reach" in text
    (tmp_path / "broken.py").write_text("1 / 0\n")
    why = refused(capsys, "config", "--task", "broken.py:Mine")
    assert "cannot be imported: division by zero" in why
