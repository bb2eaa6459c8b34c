# SPDX-License-Identifier: Apache-2.0
"""Processes of a session: a dead one is reported, none is left running."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from conftest import python_path

from wam_power_ros.cli.processes import NodeLogs, ProcessError, Processes

SLEEP = [sys.executable, "-c", "import time; time.sleep(60)"]
STUBBORN = [
    sys.executable,
    "-c",
    "import signal, time\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    "print('ready', flush=True)\ntime.sleep(60)",
]


def soon(condition: Callable[[], object], seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def alive(pid: int) -> bool:
    status = Path(f"/proc/{pid}/stat")
    return status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z"


def test_a_process_that_dies_is_named_with_the_end_of_its_log_and_one_may_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Processes(tmp_path, {"WORD": "boom"}) as processes:
        processes.start("quiet", SLEEP)
        code = "import os, sys; print(os.environ['WORD']); sys.exit(3)"
        died = processes.start("loud", [sys.executable, "-c", code])
        died.process.wait(20.0)
        processes.check(but=died)
        with pytest.raises(ProcessError, match=r"(?s)loud ended with status 3.*boom$"):
            processes.check()
        monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=4096))
        assert "The disk of" in str(died.error())
    with Processes(tmp_path, {}) as processes:
        victim = processes.start("victim", SLEEP)
        victim.process.kill()
        victim.process.wait(20.0)
        with pytest.raises(ProcessError, match=r"victim was ended by SIGKILL .*lack of memory"):
            processes.check()


def test_leaving_ends_every_process_even_one_that_ignores_the_interrupt(tmp_path: Path) -> None:
    processes = Processes(tmp_path, {})
    running = [processes.start("polite", SLEEP), processes.start("stubborn", STUBBORN)]
    assert soon(lambda: "ready" in running[1].log.read_text())
    processes.stop(timeout=3.0)
    assert [one.process.poll() for one in running] == [-signal.SIGINT, -signal.SIGTERM]


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's promise is Linux's")
def test_processes_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    code = (
        "from pathlib import Path; from wam_power_ros.cli.processes import Processes\n"
        "import sys, time\n"
        f"one = Processes(Path({str(tmp_path)!r}), {{}}).start('child', {STUBBORN!r})\n"
        "print(one.process.pid, flush=True); time.sleep(60)"
    )
    environment = os.environ | {"PYTHONPATH": python_path()}
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, env=environment)
    child = int(parent.stdout.readline())
    assert alive(child)
    assert soon(lambda: "ready" in (tmp_path / "child.log").read_text())
    parent.kill()
    parent.wait(10.0)
    assert soon(lambda: not alive(child))


def test_new_whole_lines_of_a_log_are_passed_on_once(tmp_path: Path) -> None:
    log = tmp_path / "torque_controller.log"
    log.write_text("[INFO] [1.5] [torque_controller]: of another day\n")
    logs = NodeLogs(tmp_path)
    with log.open("a") as file:
        file.write("[ERROR] [2.5] [torque_controller]: fault (jump): joint 3\nTraceback\n[WARN] [")
    assert list(logs.new()) == [("torque_controller: fault (jump): joint 3", True)]
    with log.open("a") as file:
        file.write("3.5] [torque_controller]: half a line\n")
    (tmp_path / "learner.log").write_text("[INFO] [4.0] [learner]: begun\n")
    texts = [text for text, _ in logs.new()]
    assert texts == ["learner: begun", "torque_controller: half a line"]
    assert list(logs.new()) == []
