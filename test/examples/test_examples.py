# SPDX-License-Identifier: Apache-2.0
"""Every example runs as it is, in an empty folder; those over DDS are in test/system."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT, python_path

EXAMPLES = ROOT / "examples"
OVER_DDS, DRIVER = "09_teach_learn_replay", "10_write_a_driver"
PRINTS = {  # expressions of which each line of the output is to have one, in this order
    "01_fit_a_bag": [r"8 spring-dampers", r"reproduced within \d\d? mm"],
    "02_learn_a_reach": [r"demonstrated: 0\.[1-3]", r"learnt:       0\.[6-9]"],
    "03_write_a_learner": [
        r"at first: return 0\.0",
        r"Elite: return 0\.[3-9]",
        r"Power: return 0\.[3-9]",
    ],
    "06_check_a_policy": [
        r"0\.5 .* elbow at most [\d.]+ m/s",
        r"1\.0 ",
        r"1\.5 .* would end in a fault",
    ],
    "11_tasks_of_others": [
        rf"^{task} +taught 0\.[1-5]\d*, learnt 0\.[89]"
        for task in (
            *("via_point", "throw_a_ball", "arm_with_joints"),
            *("avoid_an_obstacle", "change_the_goal"),
        )
    ],
    "08_bring_your_simulator": [r"positions in [\d.]+ s, no fault", r"from .* to .*"],
}


def output(name: str, folder: Path) -> list[str]:
    """Lines that an example prints."""
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py")],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": python_path(), "MUJOCO_GL": "disable"},
        capture_output=True,
        text=True,
        timeout=600.0,  # a busy machine
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_the_examples_are_ordered_by_their_page_and_all_tested() -> None:
    names = sorted(path.stem for path in EXAMPLES.glob("*.py"))
    listed = re.findall(r"^\| \[(\w+)\.py\]", (EXAMPLES / "README.md").read_text(), re.M)
    assert names == listed
    others = {"04_write_a_task", "05_resume_a_session", "07_use_your_arm", OVER_DDS, DRIVER}
    assert {*PRINTS, *others} == {*names}


@pytest.mark.parametrize("name", PRINTS)
def test_an_example_prints_what_it_promises(name: str, tmp_path: Path) -> None:
    lines = output(name, tmp_path)
    assert len(lines) == len(PRINTS[name])
    for line, expression in zip(lines, PRINTS[name], strict=True):
        assert re.search(expression, line), lines


@pytest.mark.long
def test_the_task_of_the_examples_is_learnt_in_a_few_rollouts_and_has_at_most_60_lines(
    tmp_path: Path,
) -> None:
    rows = [line.split() for line in output("04_write_a_task", tmp_path)]
    kinds = [row[1] for row in rows]
    assert kinds[0] == "reproduction" and kinds[-10:] == ["retest"] * 10
    beyond = [abs(float(row[-2])) for row in rows]
    assert beyond[0] > 100.0 and min(beyond[:5]) < 30.0  # [mm]; the limit of a success
    assert max(beyond[-10:]) < 30.0
    assert len((EXAMPLES / "04_write_a_task.py").read_text().splitlines()) <= 60


def test_the_resumed_session_of_the_examples_ends_with_a_report(tmp_path: Path) -> None:
    lines = output("05_resume_a_session", tmp_path)
    assert lines[0] == "resumed after 2 rollouts" and "ended after 4 rollouts" in lines[-1]
    assert "<title>Session of seed 5" in (tmp_path / "session/report.html").read_text()
    assert len((tmp_path / "session/rollouts.jsonl").read_text().splitlines()) == 4


def test_the_arm_of_the_examples_is_described_by_its_set_up(tmp_path: Path) -> None:
    lines = output("07_use_your_arm", tmp_path)
    assert lines[0].startswith("cobot7: 7 joints") and len(lines) == 9
    assert lines[-1] == "the tool may move at 0.5 m/s"
