# SPDX-License-Identifier: Apache-2.0
"""wam_power_interfaces as CMake and pip build it."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

FOLDER = ROOT / "wam_power_interfaces"
KINDS = ("action", "msg", "srv")
DEFINITIONS = sorted(path for kind in KINDS for path in FOLDER.glob(f"{kind}/*.{kind}"))
OTHERS = sorted((FOLDER / "without_ros").glob("*/*/*.*"))
# Hashes of the types as CMake has built them elsewhere: nodes of both sides meet.
HASHES = {
    "Markers": "36a59e85fa0dcebed1f0a91d748ca17e259b187f779e725af5c6701e8a03054a",
    "RigidBody": "7a1bca552c93a8da4f09083ef4327410b6687a95fe14db29292c4619166f5e66",
}


def test_cmake_builds_every_definition_and_the_manifest_names_what_they_need() -> None:
    cmake = (FOLDER / "CMakeLists.txt").read_text()
    listed = re.findall(r'"((?:action|msg|srv)/\w+\.\w+)"', cmake)
    assert listed == [str(path.relative_to(FOLDER)) for path in DEFINITIONS]
    texts = "".join(path.read_text() for path in DEFINITIONS)
    used = set(re.findall(r"^(\w+)/\w+", texts, re.MULTILINE))
    assert used <= set(re.findall(r"find_package\((\w+) REQUIRED\)", cmake))
    (dependencies,) = re.findall(r"DEPENDENCIES (.*)", cmake)
    assert set(dependencies.split()) == used
    both = [(folder / "package.xml").read_text() for folder in (ROOT, FOLDER)]
    assert len({re.findall(r"<version>(.*)</version>", text)[0] for text in both}) == 1
    manifest = both[1]
    assert set(re.findall(r"<depend>(\w+)</depend>", manifest)) == {"action_msgs", *used}


@pytest.mark.parametrize("path", [*DEFINITIONS, *OTHERS], ids=lambda path: path.stem)
def test_every_definition_is_installed_as_it_stands_here(path: Path) -> None:
    kind = path.parent.name
    module = importlib.import_module(f"{path.parents[1].name}.{kind}")
    assert getattr(module, path.stem).__module__.startswith(module.__name__)
    fields = {
        line.split()[1]
        for line in path.read_text().splitlines()
        if re.match(r"[A-Za-z]", line) and "=" not in line.partition("#")[0]
    }
    parts = {"msg": [""], "srv": ["Request", "Response"], "action": ["Goal", "Result", "Feedback"]}
    there: set[str] = set()
    whole = getattr(module, path.stem)
    for part in parts[kind]:
        there |= set((getattr(whole, part) if part else whole).get_fields_and_field_types())
    assert there - {"structure_needs_at_least_one_member"} == fields


@pytest.mark.parametrize("name", HASHES)
@pytest.mark.skipif("ROS_DISTRO" in os.environ, reason="ROS brings the package")
def test_a_type_has_the_hash_that_a_build_by_cmake_gives_it(name: str) -> None:
    described = json.loads((Path(sys.prefix) / f"share/mocap4r2_msgs/msg/{name}.json").read_text())
    found = {it["type_name"]: it["hash_string"] for it in described["type_hashes"]}
    assert found[f"mocap4r2_msgs/msg/{name}"] == f"RIHS01_{HASHES[name]}"


@pytest.mark.skipif(shutil.which("ros2") is None, reason="no ros2 on PATH")
def test_ros2_shows_the_definitions_with_their_comments() -> None:
    command = ["ros2", "interface", "show", "wam_power_interfaces/action/ExecutePolicy"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "Policy policy" in shown and "string stage" in shown


@pytest.mark.skipif("ROS_DISTRO" in os.environ, reason="colcon builds the interfaces")
def test_a_build_without_a_compiler_says_what_is_needed(tmp_path: Path) -> None:
    code = "import interface_wheel; interface_wheel.build_wheel('.')"
    environment = {**os.environ, "PATH": str(tmp_path), "PYTHONPATH": str(FOLDER / "without_ros")}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert "apt install build-essential python3-dev" in done.stderr
