# SPDX-License-Identifier: Apache-2.0
"""The launch files, run as `ros2 launch` runs them, in a Python without this package."""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from conftest import ROOT, Processes

from wam_power_ros.ros.domain import HELD

pytest.importorskip("launch_ros.actions", reason="launch_ros is not installed")
PATIENCE = 300.0  # [s of wall time]
BAGS = [str(bag) for bag in sorted((ROOT / "bags").glob("reach_*"))]
SHORT = {"demonstrations": " ".join(BAGS), "task": "reach", "trials": "2", "seed": "5"}
RUN = """
import sys
for name in ("pydantic", "wam_power_ros"):
    sys.modules[name] = None  # cannot be imported, as in the Python of another `ros2`
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

arguments = [tuple(word.split(":=", 1)) for word in sys.argv[2:]]
file = PythonLaunchDescriptionSource(sys.argv[1])
service = LaunchService()
service.include_launch_description(
    LaunchDescription([IncludeLaunchDescription(file, launch_arguments=arguments)])
)
sys.exit(service.run())
"""


class Launch:
    """A launch in a process group of its own, as a terminal starts it."""

    def __init__(self, installation: Path, processes: Processes, folder: Path) -> None:
        self._installation, self._processes, self._folder = installation, processes, folder
        self.temporary = folder / "temporary"

    def start(self, file: str, **arguments: str) -> None:
        """Begin with arguments of the launch file; `output` then tells what it has printed."""
        given = [f"{name}:={value}" for name, value in arguments.items()]
        command = ["setsid", sys.executable, "-c", RUN, str(self._installation / file), *given]
        temporary = self.temporary
        temporary.mkdir(parents=True, exist_ok=True)
        self.process = self._processes.start(
            command,
            TMPDIR=str(temporary),
            ROS_LOG_DIR=str(self._folder / "log"),
            AMENT_PREFIX_PATH=str(self._installation.parents[2]),
            **{HELD: ""},  # of a terminal, which holds no domain
        )

    @property
    def output(self) -> str:
        """What has been printed."""
        return self._processes.output(self.process)

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Wait for a condition while the launch goes on."""
        end = time.monotonic() + PATIENCE
        while not condition():
            assert self.process.poll() is None, f"ended before {what}"
            assert time.monotonic() < end, what
            time.sleep(0.1)

    def interrupt(self) -> None:
        """Ctrl-C: the terminal signals the whole group, and launch its processes once more."""
        os.killpg(self.process.pid, signal.SIGINT)

    def _others(self) -> bool:
        try:
            os.killpg(self.process.pid, 0)
        except ProcessLookupError:
            return False
        return True

    def has_ended_well(self) -> None:
        """Exit status, 0 of every node, no process left."""
        assert self.process.wait(PATIENCE) == 0
        assert "process has died" not in self.output
        assert "Traceback" not in self.output
        end = time.monotonic() + PATIENCE
        while self._others():  # the controller's second process writes its last lines
            assert time.monotonic() < end, "a process is left"
            time.sleep(0.1)


@pytest.fixture
def launch(installation: Path, processes: Processes, tmp_path: Path) -> Launch:
    return Launch(installation, processes, tmp_path)


@pytest.mark.parametrize("moment", ["each step waits for torques", "recording"])
def test_ctrl_c_ends_a_launch_cleanly_at_any_moment(
    moment: str, launch: Launch, tmp_path: Path
) -> None:
    launch.start("sim.launch.py", session=str(tmp_path / "session"), **SHORT)
    launch.until(lambda: moment in launch.output, moment)
    launch.interrupt()
    launch.has_ended_well()


def test_ctrl_c_ends_a_launched_session_cleanly_and_a_second_launch_resumes_it(
    launch: Launch, tmp_path: Path
) -> None:
    session = tmp_path / "session"
    log = session / "rollouts.jsonl"
    launch.start("sim.launch.py", session=str(session), demonstrations=" ".join(BAGS), task="reach")
    launch.until(lambda: log.exists() and log.read_text().count("\n") >= 1, "the first rollout")
    launch.interrupt()
    launch.has_ended_well()
    done = log.read_text()
    launch.start("sim.launch.py", session=str(session), task="reach")
    launch.until(lambda: len(log.read_text()) > len(done), "the next rollout")
    launch.interrupt()
    launch.has_ended_well()
    assert log.read_text().startswith(done)


def test_a_recorder_that_was_killed_is_started_again_and_the_session_goes_on(
    launch: Launch, tmp_path: Path
) -> None:
    session = tmp_path / "session"
    launch.start("sim.launch.py", session=str(session), **SHORT)
    launch.until(lambda: "recording" in launch.output, "the first recording")
    recorder = r"demonstration_recorder-\d+\]: process started with pid \[(\d+)\]"
    os.kill(int(re.findall(recorder, launch.output)[0]), signal.SIGKILL)
    assert launch.process.wait(PATIENCE) == 0
    assert len(re.findall(recorder, launch.output)) == 2
    assert launch.output.count("process has died") == 1
    assert (session / "policy.json").is_file()
    header = yaml.safe_load((session / "session.yaml").read_text())
    assert (header["seed"], header["settings"]["task"]) == (5, "reach")
    assert (session / "bags/rollout_trial-0002").is_dir()
