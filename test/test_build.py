# SPDX-License-Identifier: Apache-2.0
"""The package as colcon builds and tests it, and `make` beside a sourced ROS."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

LINKED = ("setup.py", "setup.cfg", "wam_power_ros", "hardware_sim")  # by --symlink-install
needs_colcon = pytest.mark.skipif(
    importlib.util.find_spec("colcon_ros") is None, reason="colcon is not installed"
)


def run(*command: str | Path, folder: Path, **environment: str) -> str:
    """Output of a command that must succeed."""
    inherited = {name: value for name, value in os.environ.items() if name != "MAKEFLAGS"}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env={**inherited, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_setup_runs_through_a_link_to_it_and_its_extra_test_names_pytest(tmp_path: Path) -> None:
    for name in LINKED:
        (tmp_path / name).symlink_to(ROOT / name)
    run(sys.executable, "setup.py", "-q", "egg_info", folder=tmp_path)
    extras = (tmp_path / "wam_power_ros.egg-info/requires.txt").read_text().split("\n\n")
    (extra,) = (each for each in extras if each.startswith("[test]"))  # colcon test looks there
    assert "\npytest>" in extra


def test_make_runs_colcon_by_the_python_that_the_executables_start_with() -> None:
    assert "\n.venv/bin/python -m colcon build" in run("make", "-n", "build", folder=ROOT)


def test_what_is_needed_is_named_for_rosdep_or_for_pip_and_the_document_agrees() -> None:
    sections = (ROOT / "requirements.txt").read_text().split("# [")
    needed = {
        re.split(r"[>=<;]", line)[0]
        for section in sections
        if section.startswith("core]")
        for line in section.splitlines()[1:]
        if line and not line.startswith(("#", "pin>"))  # which is Pinocchio
    }
    manifest = (ROOT / "package.xml").read_text()
    apt = set(re.findall(r"<exec_depend>python3-(\w+)</exec_depend>", manifest))
    apt = {{"yaml": "PyYAML", "pil": "pillow"}.get(name, name) for name in apt}
    (comment,) = re.findall(r"By pip.*?:(.*?)\. -->", manifest, re.DOTALL)
    pip = {name.strip() for name in comment.split(",")}
    assert needed == apt | pip
    assert not apt & pip
    page = (ROOT / "docs/ros2.md").read_text()
    named = page.partition("rosdep does not bring")[2].partition("pip")[0]
    assert set(re.findall(r"`([a-z0-9.]+)`", named)) == pip


@needs_colcon
@pytest.mark.long
def test_colcon_builds_links_and_tests_this_package(tmp_path: Path) -> None:
    colcon = (sys.executable, "-m", "colcon", "--log-base", tmp_path / "log")
    where = ("--base-paths", ROOT, "--build-base", tmp_path / "build")
    install = tmp_path / "install"
    run(*colcon, "build", *where, "--install-base", install, "--symlink-install", folder=tmp_path)
    config = install / "wam_power_ros/share/wam_power_ros/config/learner.yaml"
    assert config.resolve() == ROOT / "config/learner.yaml"
    assert (install / "wam_power_ros/lib/wam_power_ros/learner").is_file()
    assert not (install / "wam_power_ros/bin").exists()
    chosen = ("--pytest-args", "test/test_rotations.py")
    run(*colcon, "test", *where, "--install-base", install, *chosen, folder=tmp_path)
    results = ("test-result", "--test-result-base", tmp_path / "build")
    summary = run(*colcon, *results, folder=tmp_path).split()
    tests, failures = summary[summary.index("tests,") - 1], summary[summary.index("failures,") - 1]
    assert int(tests) > 0
    assert failures == "0"
