# SPDX-License-Identifier: Apache-2.0
"""A signal during the imports of a process ends it as one afterwards, without output."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from conftest import ROOT, python_path

from wam_power_ros import entry

# Short sleeps, because a signal just before a sleep does not end it.
SLOW = "import time; print('importing', flush=True); [time.sleep(0.05) for _ in range(12000)]"
STARTED_BY_OTHERS = ("enabling_switch",)
GUARDED = {
    path.relative_to(ROOT).with_suffix("").as_posix().replace("/", "."): path.read_text()
    for folder in ("wam_power_ros/console", "hardware_sim")
    for path in sorted((ROOT / folder).glob("*.py"))
    if "\ndef main()" in path.read_text() and path.stem not in STARTED_BY_OTHERS
}
EXECUTABLES = re.findall(r'f"[\w-]+ = \{NAME\}\.entry:(\w+)"', (ROOT / "setup.py").read_text())
FOR_A_PERSON = {"wam_power_ros.cli.main", "wam_power_ros.console.replay_running"}
FOR_A_PERSON |= {"wam_power_ros.nodes.check_driver"}
PROGRAM = "import sys; from wam_power_ros.entry import wam_power; sys.exit(wam_power())"


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of libraries whose import never returns."""
    folder = tmp_path_factory.mktemp("slow")
    for name in ("numpy", "yaml", "rclpy"):
        (folder / f"{name}.py").write_text(SLOW)
    return folder


@pytest.mark.parametrize("name", EXECUTABLES)
def test_every_executable_begins_with_the_guard_of_its_imports(name: str) -> None:
    begun = getattr(entry, name)
    assert begun.func is entry.start and find_spec(begun.args[0])
    assert (entry.INTERRUPTED in begun.args) == (begun.args[0] in FOR_A_PERSON)


@pytest.mark.parametrize("name", GUARDED)
def test_every_module_with_a_main_has_the_guard_before_its_other_imports(name: str) -> None:
    (guard,) = re.findall(r'raise SystemExit\(start\("(.*)"(.*)\)\)', GUARDED[name])
    assert guard == (name, ", INTERRUPTED" if name in FOR_A_PERSON else "")
    before, _, _ = GUARDED[name].partition('if __name__ == "__main__"')
    assert re.findall(r"^(?:from|import) (\w+)", before, re.MULTILINE) == ["__future__"]


@pytest.mark.parametrize(
    ("words", "number", "status"),
    [
        (["-m", "wam_power_ros.entry", "learner"], signal.SIGINT, 0),
        (["-m", "wam_power_ros.entry", "check_driver"], signal.SIGTERM, entry.INTERRUPTED),
        (["-m", "wam_power_ros.cli"], signal.SIGINT, entry.INTERRUPTED),
        (["-c", PROGRAM], signal.SIGINT, entry.INTERRUPTED),
    ],
)
def test_a_signal_during_the_imports_ends_a_process_without_a_word(
    words: list[str], number: int, status: int, slow: Path
) -> None:
    process = subprocess.Popen(
        [sys.executable, *words],
        cwd=slow,
        env={**os.environ, "PYTHONPATH": python_path(slow, ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "importing\n"
    process.send_signal(number)
    assert process.communicate(timeout=60.0) == ("", "")
    assert process.returncode == status


@pytest.mark.parametrize(
    ("imported", "status"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGINT)\ndef main(): return 7\n", 7),
        (  # linear algebra has one thread, whatever the machine says
            "import os; seen = [os.environ[name] for name in os.environ if 'NUM_THREADS' in name]\n"
            "def main(): return len(seen) if set(seen) == {'1'} else 0\n",
            len(entry.ONE_THREAD),
        ),
    ],
)
def test_what_is_imported_has_one_thread_and_an_ignored_signal_stays_ignored(
    imported: str, status: int, tmp_path: Path
) -> None:
    (tmp_path / "imported.py").write_text(imported)
    code = (
        "import signal; from wam_power_ros import entry;"
        "signal.signal(signal.SIGINT, signal.SIG_IGN); raise SystemExit(entry.start('imported'))"
    )
    environment = {"PYTHONPATH": python_path(tmp_path, ROOT), "OMP_NUM_THREADS": "4"}
    ended = subprocess.run([sys.executable, "-c", code], env={**os.environ, **environment})
    assert ended.returncode == status


def test_a_missing_system_library_is_named_with_its_package(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    error = ImportError("libgomp.so.1: cannot open shared object file", name="pinocchio.pinocchio")
    with monkeypatch.context() as here:
        here.setattr(entry, "find_library", lambda name: None)
        assert entry.missing(error) == f"{error}: apt install libgomp1"
    with pytest.raises(ImportError):
        entry.missing(error)


@pytest.mark.skipif("ROS_DISTRO" in os.environ, reason="ROS has one Python")
def test_a_node_that_a_ros2_of_another_python_runs_loads_its_own_libraries(tmp_path: Path) -> None:
    (tmp_path / "librcl.so").touch()  # no library: who loads it fails
    (tmp_path / "heard.py").write_text("import rclpy\ndef main(): print('loaded')")
    given = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "LD_LIBRARY_PATH": f"{tmp_path}:/anything"}
    environment = {**os.environ, **given, "PYTHONPATH": python_path(tmp_path)}
    code = "from wam_power_ros import entry; entry.start('heard')"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True
    )
    assert done.stdout == "loaded\n", done.stderr
