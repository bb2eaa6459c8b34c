# SPDX-License-Identifier: Apache-2.0
"""A laboratory's own task, in a package of its own: taught, practised, reported.

`lab_package` is built and installed here, and found by its entry points: nothing of it is named in
this repository outside this folder.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Environment in which the package is installed, beside those of this one."""
    place = tmp_path_factory.mktemp("installed")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    source = shutil.copytree(HERE / "lab_package", tmp_path_factory.mktemp("source") / "package")
    command += ["--no-build-isolation", "--target", str(place), str(source)]
    subprocess.run(command, check=True, cwd=place)
    path = os.pathsep.join([str(place), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    return os.environ | {"PYTHONPATH": path, "ROS_DOMAIN_ID": "", "MUJOCO_GL": "disable"}


def wam_power(environment: dict[str, str], folder: Path, *arguments: str) -> str:
    command = [sys.executable, "-m", "wam_power_ros.cli", *arguments]
    ended = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300.0
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


def test_it_is_taught_practised_and_reported_through_its_entry_points(
    environment: dict[str, str], tmp_path: Path
) -> None:
    output = wam_power(
        environment,
        tmp_path,
        *("learn", "--task", "carry", "--seed", "3", "--demonstrations", "1"),
        *("--trials", "2", "--session", "s"),
    )
    rows = [json.loads(line) for line in (tmp_path / "s/rollouts.jsonl").read_text().splitlines()]
    assert [row["kind"] for row in rows] == ["reproduction", "explore"]
    assert all(0.0 < row["ret"] < 1.0 and set(row["terms"]) == {"calm", "goal"} for row in rows)
    assert all(row["truth"]["off"] < 0.2 for row in rows)  # of its own scene
    assert "mm off" in output and "calm in" in output
    report = (tmp_path / "s/report.html").read_text()
    assert "mm off" in report and "carry" in report
    assert "The ball follows the pan." in report and "kept the ball in the middle" in report
    (tmp_path / "s/report.html").unlink()
    wam_power(environment, tmp_path, "report", "s")
    assert (tmp_path / "s/report.html").read_text() == report


def test_without_the_package_the_task_is_unknown_and_nothing_starts(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "wam_power_ros.cli", "learn", "--task", "carry"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60.0)
    assert ended.returncode == 2
    assert "task 'carry' is not one of flip, reach" in ended.stderr
    assert list(tmp_path.iterdir()) == []
