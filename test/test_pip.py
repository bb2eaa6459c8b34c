# SPDX-License-Identifier: Apache-2.0
"""What pip installs on a machine without ROS: a wheel, made of the source distribution."""

import os
import subprocess
import sys
import tarfile
from pathlib import Path
from zipfile import ZipFile

import pytest

from wam_power_ros.practice import session

ROOT = Path(__file__).resolve().parents[1]
ABSENT = ("rclpy", "wam_power_interfaces", "sensor_msgs", "viser", "pyarrow", "xacro")
BUILD = "from setuptools import build_meta as b; import sys; b.build_{}(sys.argv[1])"
pytestmark = pytest.mark.long


def run(*words: object, cwd: Path, **more: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if name != "ROS_DISTRO"}
    command = [sys.executable, *map(str, words)]
    return subprocess.run(
        command, cwd=cwd, env={**kept, **more}, capture_output=True, text=True, timeout=300
    )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Wheel built of the source distribution of the files that git knows."""
    folder = tmp_path_factory.mktemp("dist")
    listed = subprocess.check_output(["git", "ls-files", "-z"], cwd=ROOT, text=True)
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (folder / "checkout" / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / "checkout" / name).write_bytes((ROOT / name).read_bytes())
    built = run("-c", BUILD.format("sdist"), folder, cwd=folder / "checkout")
    assert built.returncode == 0, built.stderr
    with tarfile.open(next(folder.glob("*.tar.gz"))) as archive:
        archive.extractall(folder / "sdist", filter="data")
    (source,) = (folder / "sdist").iterdir()
    built = run("-c", BUILD.format("wheel"), folder, cwd=source)
    assert built.returncode == 0, built.stderr
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def installed(wheel: Path) -> Path:
    """Folder into which the wheel is installed, with a Python that lacks every extra."""
    folder = wheel.parent / "installed"
    words = ("-m", "pip", "install", "--quiet", "--no-deps", "--target", folder, wheel)
    assert (done := run(*words, cwd=wheel.parent)).returncode == 0, done.stderr
    absent = f"import sys\nfor name in {ABSENT}:\n    sys.modules[name] = None\n"
    (folder / "sitecustomize.py").write_text(absent)
    return folder


def wam_power(installed: Path, *words: str) -> subprocess.CompletedProcess[str]:
    where = {"PYTHONPATH": str(installed), "MUJOCO_GL": "disable"}
    return run("-m", "wam_power_ros.cli", *words, cwd=installed.parent, **where)


def test_the_wheel_puts_one_command_on_the_path_and_all_files_beside_it(wheel: Path) -> None:
    with ZipFile(wheel) as archive:
        names = archive.namelist()
        entries = archive.read(next(n for n in names if n.endswith("entry_points.txt"))).decode()
        metadata = archive.read(next(n for n in names if n.endswith("/METADATA"))).decode()
    scripts = entries.partition("[console_scripts]\n")[2].partition("\n\n")[0]
    assert scripts.split(" = ")[0] == "wam-power"
    assert "\n" not in scripts.strip()
    assert "Requires-Dist: pin" in metadata
    shared = [name.partition("/data/share/wam_power_ros/")[2] for name in names]
    for folder in ("config", "launch", "urdf", "bags", "security"):
        tracked = subprocess.check_output(["git", "ls-files", folder], cwd=ROOT, text=True).split()
        assert {*tracked} <= {*shared}
    assert any(name.startswith("wam_power_ros/_kernel.") for name in names)


COMMANDS = ("learn", "teach", "config", "commission", "doctor", "view", "replay", "bags", "run")


def test_every_command_says_its_options_where_every_extra_is_missing(installed: Path) -> None:
    assert wam_power(installed, "--version").stdout.startswith("wam_power_ros ")
    whole = wam_power(installed, "--help")
    assert whole.returncode == 0, whole.stderr
    for command in COMMANDS:
        told = wam_power(installed, command, "--help")
        assert (told.returncode, told.stderr) == (0, "")


@pytest.mark.parametrize(
    ("words", "extra"),
    [
        (["learn", "--session", "no_ros"], "[ros]"),
        (["teach"], "[ros]"),
        (["config", "wam_can"], "[ros]"),
        (["run", "learner"], "[ros]"),
        (["view", str(ROOT / "bags")], "[view]"),
    ],
)
def test_a_command_that_needs_an_extra_names_it_in_one_line(
    words: list[str], extra: str, installed: Path
) -> None:
    refused = wam_power(installed, *words)
    assert refused.returncode == 2
    assert "Traceback" not in refused.stderr
    assert extra in refused.stderr.splitlines()[-1]


def test_a_reach_is_learnt_without_ros(installed: Path) -> None:
    words = ("--task", "reach", "--demonstrations", "1", "--trials", "3", "--session", "s")
    done = wam_power(installed, "learn", "--in-process", *words)
    assert done.returncode == 0, done.stderr
    records = session.read(installed.parent / "s").records
    assert len(records) > 3
    assert (installed.parent / "s/report.html").is_file()
