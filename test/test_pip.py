# SPDX-License-Identifier: Apache-2.0
"""What pip installs on a machine without ROS: a wheel, made of the source distribution.

The empty environment it is installed into gets the core's requirements as links to where they are
installed already, so nothing is downloaded, and what is no requirement is missing.
"""

import argparse
import os
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from email import message_from_bytes
from email.message import Message
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from wam_power_ros.cli import main
from wam_power_ros.practice import session

ROOT = Path(__file__).resolve().parents[1]
BUILD = "from setuptools import build_meta as b; import sys; b.build_{}(sys.argv[1])"
OURS = ("ROS_DISTRO", "PYTHONPATH")  # variables that would change what is built or found
pytestmark = pytest.mark.long


def run(*words: object, cwd: Path, **more: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if name not in OURS}
    command, environment = list(map(str, words)), {**kept, **more}
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300
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
    python = (sys.executable, "-c")
    built = run(*python, BUILD.format("sdist"), folder, cwd=folder / "checkout")
    assert built.returncode == 0, built.stderr
    with tarfile.open(next(folder.glob("*.tar.gz"))) as archive:
        archive.extractall(folder / "sdist", filter="data")
    (source,) = (folder / "sdist").iterdir()
    assert not (source / "test").exists()
    built = run(*python, BUILD.format("wheel"), folder, cwd=source)
    assert built.returncode == 0, built.stderr
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def described(wheel: Path) -> Message:
    """Metadata of the wheel."""
    with ZipFile(wheel) as archive:
        (name,) = (each for each in archive.namelist() if each.endswith("/METADATA"))
        return message_from_bytes(archive.read(name))


def needed(lines: list[str], extras: frozenset[str] = frozenset()) -> Iterator[Requirement]:
    """Requirements that apply to this Python without extras, or with some."""
    for requirement in map(Requirement, lines):
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": each}) for each in ("", *extras)):
            yield requirement


@pytest.fixture(scope="module")
def folder(wheel: Path, described: Message) -> Path:
    """Working folder beside an environment with the wheel and the core's requirements alone."""
    environment = wheel.parent / "venv"
    made = run(sys.executable, "-m", "venv", "--without-pip", environment, cwd=wheel.parent)
    assert made.returncode == 0, made.stderr
    (packages,) = environment.glob("lib/python*/site-packages")
    waiting, met = [*needed(described.get_all("Requires-Dist", []))], set()
    while waiting:
        requirement = waiting.pop()
        if (key := str(requirement)) in met:
            continue
        met.add(key)
        try:
            found = metadata.distribution(requirement.name)
        except metadata.PackageNotFoundError as error:
            pytest.skip(f"{error}: of ROS, which has no wheels")
        waiting += needed(found.requires or [], frozenset(requirement.extras))
        for top in {file.parts[0] for file in found.files or []} - {"..", "__pycache__"}:
            if not (packages / top).exists():
                (packages / top).symlink_to(Path(str(found.locate_file(top))).resolve())
    pip = (sys.executable, "-m", "pip", "--python", environment, "install", "--quiet", "--no-index")
    done = run(*pip, "--no-deps", wheel, cwd=wheel.parent)
    assert done.returncode == 0, done.stderr
    (working := wheel.parent / "working").mkdir()
    return working


def wam_power(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    program = folder.parent / "venv/bin/wam-power"
    return run(program, *words, cwd=folder, MUJOCO_GL="disable", COLUMNS="200")


def test_the_wheel_puts_one_command_on_the_path_and_all_files_beside_it(wheel: Path) -> None:
    with ZipFile(wheel) as archive:
        names = archive.namelist()
        entries = archive.read(next(n for n in names if n.endswith("entry_points.txt"))).decode()
    scripts = entries.partition("[console_scripts]\n")[2].partition("\n\n")[0]
    assert scripts.split(" = ")[0] == "wam-power"
    assert "\n" not in scripts.strip()
    shared = [name.partition("/data/share/wam_power_ros/")[2] for name in names]
    for folder in ("config", "launch", "urdf", "bags", "security"):
        tracked = subprocess.check_output(["git", "ls-files", folder], cwd=ROOT, text=True).split()
        assert {*tracked} <= {*shared}
    assert any(name.startswith("wam_power_ros/_kernel.") for name in names)


def test_the_metadata_are_true_and_the_core_requires_no_extra(described: Message) -> None:
    package = ElementTree.parse(ROOT / "package.xml")
    assert described["Version"] == package.findtext("version")
    assert described["License"] == package.findtext("license")
    assert described["Author"] in (ROOT / "CITATION.cff").read_text()
    assert not {"Author-email", "Maintainer", "Maintainer-email"} & {*described.keys()}
    pythons = SpecifierSet(described["Requires-Python"])
    classified = [line.rpartition(" ")[2] for line in described.get_all("Classifier", [])]
    stated = [version for version in classified if version.startswith("3.")]
    assert stated == [f"3.{minor}" for minor in range(30) if f"3.{minor}" in pythons]
    core = {requirement.name for requirement in needed(described.get_all("Requires-Dist", []))}
    assert {"pin", "mujoco", "numpy"} < core
    assert not core & {"viser", "joblib", "dask", "pyarrow", "xacro", "argcomplete"}
    assert not [name for name in core if name.startswith(("ros-", "wam"))]


def commands(parser: argparse.ArgumentParser) -> Iterator[tuple[str, ...]]:
    """Words that lead to each command of a parser, and to each command of those."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, sub in action.choices.items():
                yield (name,)
                yield from ((name, *words) for words in commands(sub))


COMMANDS = [*commands(main._parser())]
ASK_ALL = f"""
from wam_power_ros.cli.main import main
for words in {COMMANDS}:
    try:
        main([*words, "--help"])
    except SystemExit as end:
        print("ended:", *words, end.code)
"""


def test_every_command_says_its_options_where_every_extra_is_missing(folder: Path) -> None:
    assert wam_power(folder, "--version").stdout.startswith("wam_power_ros ")
    assert wam_power(folder, "--help").stdout.startswith("usage: wam-power ")
    told = run(folder.parent / "venv/bin/python", "-c", ASK_ALL, cwd=folder)
    ended = [line for line in told.stdout.splitlines() if line.startswith("ended: ")]
    assert ended == [f"ended: {' '.join(words)} 0" for words in COMMANDS], told.stderr
    assert len(COMMANDS) > 20 and ("bags", "export") in COMMANDS


@pytest.mark.parametrize(
    ("words", "extra"),
    [
        (["learn", "--session", "no_ros"], "[ros]"),
        (["run", "learner"], "[ros]"),
        (["view", str(ROOT / "bags")], "[view]"),
        (
            ["bags", "export", str(ROOT / "bags/demo_20261121_121737"), "--output", "x.parquet"],
            "[export]",
        ),
    ],
)
def test_a_command_that_needs_an_extra_names_it_in_one_line(
    words: list[str], extra: str, folder: Path
) -> None:
    refused = wam_power(folder, *words)
    assert refused.returncode == 2
    assert "Traceback" not in refused.stderr
    assert f'pip install "wam_power_ros{extra}"' in refused.stderr.splitlines()[-1]


def test_a_flip_is_learnt_without_ros(folder: Path) -> None:
    words = ("--seed", "1", "--demonstrations", "1", "--trials", "2", "--session", "s")
    done = wam_power(folder, "learn", "--in-process", *words)
    assert done.returncode == 0, done.stderr
    records = session.read(folder / "s").records
    assert [record.kind for record in records].count("retest") == 10
    assert (folder / "s/report.html").is_file()
