# SPDX-License-Identifier: Apache-2.0
"""A laboratory's own task, in a package of its own: taught, practised, reported.

`lab_package` is built and installed here, and found by its entry points: nothing of it is named in
this repository outside this folder. Its tool is a fork in a URDF of its own, its body a puck with
one marker.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import python_path

from wam_power_ros.params.resources import share

PACKAGE = Path(__file__).parent / "lab_package"
SHAPE = '<collision><origin xyz="%s"/><geometry><box size="%s"/></geometry></collision>'
SHAPES = (("0.03 0.03 -0.04", "0.02 0.04 0.03"), ("-0.03 0.03 -0.04", "0.02 0.04 0.03"))  # prongs
FORK = f"""<link name="fork">
    <inertial><origin xyz="-0.07 0 0.01"/><mass value="0.3"/>
      <inertia ixx="0.0006" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>
    {"".join(SHAPE % shape for shape in SHAPES)}
  </link>
</robot>
"""
IN_PROCESS = """
import json, sys
from pathlib import Path
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning import policy
from wam_power_ros.params import overlay

session = Path(sys.argv[1])
setup = overlay.read(session / "logs/parameters.yaml").changed({"wam_sim": {"seed": 3}})
bench, best = Environment.from_setup(setup), policy.from_json((session / "policy.json").read_text())
rollout, truth = bench.run(best)
model = bench.world.model
shapes = [model.geom(k).name for k in range(model.ngeom)]
print(json.dumps({"truth": truth, "shapes": shapes, "turned": rollout.body.quat_xyzw.tolist()}))
"""


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Environment in which the package is installed, beside those of this one."""
    place = tmp_path_factory.mktemp("installed")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    source = shutil.copytree(PACKAGE, tmp_path_factory.mktemp("source") / "package")
    arm, _, _ = share("urdf/wam7.urdf").read_text().partition('<link name="pan">')
    urdf = arm.replace('<child link="pan"/>', '<child link="fork"/>') + FORK
    (source / "lab_puck/wam_fork.urdf").write_text(urdf)
    command += ["--no-build-isolation", "--target", str(place), str(source)]
    subprocess.run(command, check=True, cwd=place)
    path = python_path(place)
    return os.environ | {"PYTHONPATH": path, "ROS_DOMAIN_ID": "", "MUJOCO_GL": "disable"}


def wam_power(environment: dict[str, str], folder: Path, *arguments: str) -> str:
    command = [sys.executable, "-m", "wam_power_ros.cli", *arguments]
    ended = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300.0
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.mark.long
def test_it_is_taught_practised_and_reported_through_its_entry_points(
    environment: dict[str, str], tmp_path: Path
) -> None:
    output = wam_power(
        environment,
        tmp_path,
        *("learn", "--task", "puck", "--seed", "3", "--demonstrations", "1"),
        *("--trials", "2", "--session", "s"),
    )
    assert "learner model_based: learns from beside, beyond" in output
    rows = [json.loads(line) for line in (tmp_path / "s/rollouts.jsonl").read_text().splitlines()]
    misses = [row["observation"]["beyond"] for row in rows[:2]]
    assert min(map(abs, misses[1:])) < 0.5 * abs(misses[0]) and "mm, beyond " in output
    for row in rows:
        stopped = row["truth"]["stopped"]  # of its own scene
        assert row["observation"]["beyond"] == pytest.approx(stopped[1] - 0.3, abs=0.005)
    # in one process it is the same rollout, with the fork of the URDF and no pan
    best = json.loads((tmp_path / "s/policy.json").read_text())["id"]
    command = [sys.executable, "-c", IN_PROCESS, str(tmp_path / "s")]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120.0)
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert found["truth"] == next(row["truth"] for row in rows if row["id"] == best)
    assert not any("pan" in name for name in found["shapes"])
    assert len(found["turned"]) > 20
    assert all(quat == [0.0, 0.0, 0.0, 1.0] for quat in found["turned"])  # one marker

    report = (tmp_path / "s/report.html").read_text()
    assert "mm, beyond " in report and "task puck" in report
    assert "The puck slides on." in report and "stopped the puck at the mark" in report


def test_a_package_with_a_task_and_its_scene_has_at_most_80_lines() -> None:
    files = [path for path in PACKAGE.rglob("*") if path.suffix in (".py", ".toml", ".yaml")]
    assert len(files) == 5
    assert sum(len(path.read_text().splitlines()) for path in files) <= 80
