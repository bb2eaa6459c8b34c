# SPDX-License-Identifier: Apache-2.0
"""Every command of docs/hardware.md is run, in order, against stand-ins shaped like the drivers.

Commands that need a ROS installation are translated: `ros2 run` to the same entry point, a launch
file to the nodes it starts, calls to calls of the same type. An unknown command fails the test.
"""

from __future__ import annotations

import importlib
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from conftest import ROOT, Probe, Process, Processes
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from test_session_over_dds import children

from wam_power_ros.params import overlay
from wam_power_ros.ros import interface

GUIDE = (ROOT / "docs/hardware.md").read_text()
CLI = [sys.executable, "-m", "wam_power_ros.cli"]
TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
}
PATIENCE = 240.0  # [s] for a command, on a busy machine


def blocks(language: str) -> list[str]:
    return re.findall(rf"^ *```{language}\n(.*?)^ *```", GUIDE, re.DOTALL | re.MULTILINE)


def commands() -> list[list[str]]:
    """Words of every command, in order; comments left out."""
    lines = "\n".join(blocks("bash")).replace("\\\n", " ").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def found(folder: Path, word: str) -> list[Path | str]:
    """What a shell makes of a word."""
    return sorted(folder.glob(word)) if "*" in word else [word]


def interrupted_learning(command: list[str], folder: Path, environment: dict[str, str]) -> None:
    """Let `wam-power learn ... --session NAME` run one more rollout of its session, then Ctrl-C."""
    log = folder / command[command.index("--session") + 1] / "rollouts.jsonl"
    lines = lambda: log.read_text().count("\n") if log.exists() else 0  # noqa: E731
    before, output = lines(), folder / "learn.log"
    with output.open("wb") as file:
        process = subprocess.Popen(
            command,
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
        )
    end = time.monotonic() + PATIENCE
    try:
        while lines() == before and process.poll() is None and time.monotonic() < end:
            time.sleep(0.1)
        assert lines() > before, output.read_text()
        nodes = children(process)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 130, output.read_text()
        assert not [pid for pid in nodes if Path(f"/proc/{pid}").exists()]
        assert output.read_text().rstrip().endswith(f"--session {log.parent.name}")
    finally:
        process.kill()


class Lab:
    """A lab whose devices are stand-ins, and a person who types what the guide says."""

    def __init__(self, folder: Path, probe: Probe, processes: Processes) -> None:
        self._folder, self._probe, self._processes = folder, probe, processes
        self._outside = dict(processes.environment)
        del self._outside["ROS_DOMAIN_ID"]
        (folder / "bags").symlink_to(ROOT / "bags")
        for text in blocks("yaml"):
            name = text.partition("\n")[0].removeprefix("# ")
            (folder / name).write_text(text)
        mine = yaml.safe_load((folder / "my_lab.yaml").read_text())
        for node in ("wam_sim", "torque_controller"):  # tests share their machine
            mine.setdefault(node, {"ros__parameters": {}})
            mine[node]["ros__parameters"]["realtime_priority"] = 0
        (folder / "my_lab.yaml").write_text(yaml.safe_dump(mine))
        steps = {"wam_sim": {"ros__parameters": {"pace": "lockstep"}}}  # however busy the machine
        (folder / "lockstep.yaml").write_text(yaml.safe_dump(steps))
        self._running: list[Process] = []
        names = ["geodude", "natnet_ros2", str(folder / "my_lab.yaml")]
        self._setup = overlay.setup(names, simulated=True)
        self._start("hardware_sim.main", self._setup)

    def _start(self, module: str, setup: overlay.Setup) -> None:
        file = self._folder / f"{module}.yaml"
        file.write_text(overlay.text(setup))
        command = [sys.executable, "-m", module, "--ros-args", "--params-file", str(file)]
        self._running.append(self._processes.start(command))

    def type(self, words: list[str]) -> None:
        """Do what a command does."""
        verb = words[:2] if words[0] == "ros2" else words[:1]
        if verb == ["wam-power"]:
            self._wam_power(words[1:])
        elif words[:3] == ["ros2", "run", "wam_power_ros"]:
            self._run([*CLI, "run", *words[3:]], domain=True)
        elif words[:3] == ["ros2", "launch", "wam_power_ros"]:
            self._launch(*words[3:])
        elif words[:3] == ["ros2", "topic", "hz"]:
            self._hear(words[3])
        elif words[:3] == ["ros2", "lifecycle", "set"]:
            self._change(*words[3:])
        elif words[:3] == ["ros2", "service", "call"]:
            self._call(*words[3:])
        else:
            pytest.fail(f"this test does not know how to run {shlex.join(words)}")

    def _wam_power(self, words: list[str]) -> None:
        words = [str(path) for word in words for path in found(self._folder, word)]
        if "--speed" in words:  # a person sees what comes; a test need not wait for it
            words[words.index("--speed") + 1] = "0.6"
        if words[0] in ("replay", "teach", "learn"):
            self.leave()  # as the guide says: end the launch file first
            words += ["--config", str(self._folder / "lockstep.yaml"), "--simulate"]
        if words[0] == "learn":
            interrupted_learning([*CLI, *words], self._folder, self._outside)
        else:
            self._run([*CLI, *words])

    def _run(self, command: list[str], domain: bool = False) -> None:
        """Run a command, in the domain of the nodes or, for a simulation, in a free one."""
        ended = subprocess.run(
            command,
            cwd=self._folder,
            env=self._processes.environment if domain else self._outside,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        sys.stdout.write(ended.stdout + ended.stderr)
        assert ended.returncode == 0, ended.stderr

    def _launch(self, file: str, *arguments: str) -> None:
        """What launch/hardware.launch.py starts; `launch` itself is not among the wheels."""
        assert (ROOT / "launch" / file).is_file()
        given = dict(argument.split(":=") for argument in arguments)
        names = [
            str(self._folder / name) if name.endswith(".yaml") else name
            for name in given.pop("config").split()
        ]
        assert given == {}
        setup = overlay.setup(names, simulated=True)
        setup["torque_controller"]["autostart"] = False
        for node in ("torque_controller", "pancake_tracker", "demonstration_recorder"):
            self._start(f"wam_power_ros.nodes.{node}", setup)

    def _hear(self, topic: str) -> None:
        assert topic == f"/{self._setup['torque_controller']['state_topic']}"
        heard = self._probe.listen(JointState, topic, interface.STATE_RECORD)
        self._probe.until(lambda: len(heard) > 100, f"states on {topic}")

    def _change(self, node: str, transition: str) -> None:
        request = ChangeState.Request()
        request.transition.id = TRANSITIONS[transition]
        name = f"{node}/change_state"
        there = lambda: name in dict(self._probe.node.get_service_names_and_types())  # noqa: E731
        self._probe.until(there, name, PATIENCE)
        changed = lambda: self._probe.call(ChangeState, name, request, PATIENCE).success  # noqa: E731
        self._probe.until(changed, transition, PATIENCE)

    def _call(self, name: str, kind: str, request: str = "{}") -> None:
        package, _, type_ = kind.partition("/srv/")
        service = getattr(importlib.import_module(f"{package}.srv"), type_)
        filled = service.Request(**yaml.safe_load(request))

        def agreed() -> bool:
            response = self._probe.call(service, name, filled, PATIENCE)
            reset = name == f"/{interface.RESET}"
            if response.success or (reset and "no fault" in response.message):
                return True  # without a fault there is nothing to reset
            self._probe.call(Trigger, interface.RESET, deadline=PATIENCE)  # as the guide says
            return False

        self._probe.until(agreed, name, PATIENCE)

    def leave(self) -> None:
        """End the launch file and the devices; a simulation starts its own."""
        while self._running:
            self._processes.end(self._running.pop())


@pytest.fixture
def lab(tmp_path: Path, probe: Probe, processes: Processes) -> Iterator[Lab]:
    lab = Lab(tmp_path, probe, processes)
    yield lab
    lab.leave()


@pytest.mark.long
def test_every_command_of_the_guide_runs(lab: Lab) -> None:
    assert len(commands()) > 10
    for words in commands():
        began = time.monotonic()
        sys.stdout.write(f"$ {shlex.join(words)}\n")
        lab.type(words)
        sys.stdout.write(f"  {time.monotonic() - began:.1f} s\n")


def test_a_command_that_is_not_known_fails() -> None:
    lab = Lab.__new__(Lab)
    with pytest.raises(pytest.fail.Exception, match="does not know how to run"):
        lab.type(["ros2", "bag", "play", "everything"])
