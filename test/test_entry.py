# SPDX-License-Identifier: Apache-2.0
"""A signal during the imports of a process ends it as one afterwards, without output."""

from __future__ import annotations

import itertools
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT, python_path

from wam_power_ros import entry

# Short sleeps, because a signal just before a sleep does not end it.
SLOW = "import time; print('importing', flush=True); [time.sleep(0.05) for _ in range(12000)]"
GUARDED = [
    path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
    for folder in ("wam_power_ros/nodes", "wam_power_ros/console", "hardware_sim")
    for path in sorted((ROOT / folder).glob("*.py"))
    if "\ndef main()" in path.read_text()
    and path.stem not in ("preparation_worker", "enabling_switch")
]
EXECUTABLES = re.findall(r'f"[\w-]+ = \{NAME\}\.entry:(\w+)"', (ROOT / "setup.py").read_text())
WAYS = {
    **{f"-m {name}": ["-m", name] for name in [*GUARDED, "wam_power_ros.cli"]},
    "-m wam_power_ros.entry learner": ["-m", "wam_power_ros.entry", "learner"],
    **{
        name: ["-c", f"import sys; from wam_power_ros.entry import {name}; sys.exit({name}())"]
        for name in EXECUTABLES
    },
}


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of libraries whose import never returns."""
    folder = tmp_path_factory.mktemp("slow")
    for name in ("numpy", "yaml", "rclpy"):
        (folder / f"{name}.py").write_text(SLOW)
    return folder


def test_every_executable_and_every_module_with_a_main_is_asked() -> None:
    assert len(EXECUTABLES) == 12
    assert len(GUARDED) == 10
    assert set(EXECUTABLES) < set(vars(entry))


@pytest.mark.parametrize(
    ("way", "number"), zip(WAYS, itertools.cycle((signal.SIGINT, signal.SIGTERM)), strict=False)
)
def test_a_signal_during_the_imports_ends_a_process_without_a_word(
    way: str, number: int, slow: Path
) -> None:
    path = python_path(slow, ROOT)
    process = subprocess.Popen(
        [sys.executable, *WAYS[way]],
        cwd=slow,
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "importing\n"
    process.send_signal(number)
    printed = process.communicate(timeout=60.0)
    assert printed == ("", "")
    for_a_person = re.search(r"check_driver|console|\bcli\b|wam_power$|^replay$", way)
    assert process.returncode == (entry.INTERRUPTED if for_a_person else 0)


def test_a_signal_that_is_ignored_stays_ignored(tmp_path: Path) -> None:
    (tmp_path / "imported.py").write_text(
        "import os, signal; os.kill(os.getpid(), signal.SIGINT)\ndef main(): return 7\n"
    )
    code = (
        "import signal; from wam_power_ros import entry;"
        "signal.signal(signal.SIGINT, signal.SIG_IGN); raise SystemExit(entry.start('imported'))"
    )
    path = python_path(tmp_path, ROOT)
    ended = subprocess.run([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": path})
    assert ended.returncode == 7


def test_linear_algebra_has_one_thread_whatever_the_machine_says(tmp_path: Path) -> None:
    (tmp_path / "imported.py").write_text(
        "import os; seen = [os.environ[name] for name in os.environ if 'NUM_THREADS' in name]\n"
        "def main(): return len(seen) if set(seen) == {'1'} else 0\n"
    )
    code = "from wam_power_ros import entry; raise SystemExit(entry.start('imported'))"
    path = python_path(tmp_path, ROOT)
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "4"}
    ended = subprocess.run([sys.executable, "-c", code], env=environment)
    assert ended.returncode == len(entry.ONE_THREAD)
