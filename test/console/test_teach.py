# SPDX-License-Identifier: Apache-2.0
"""A series of takes in a terminal: kept, repeated, discarded, ended, interrupted."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from bag_samples import demonstration, random_q
from conftest import Probe, Processes
from std_srvs.srv import SetBool, Trigger

from wam_power_interfaces.action import Demonstrate, ResetScene
from wam_power_ros.bags import series
from wam_power_ros.ros import interface
from wam_power_ros.ros.action_server import Action
from wam_power_ros.ros.outcomes import Answer, Code


class Terminal:
    """Teaching by the demonstrator of a stand-in whose services the test offers."""

    def __init__(self, probe: Probe, processes: Processes, folder: Path) -> None:
        self._probe, self._folder = probe, folder
        self.file, self.text, self._recorded = folder / series.FILE, "", 0
        probe.node.create_service(SetBool, interface.GRAVITY_COMPENSATION, _done)
        for kind, name in (
            (ResetScene, interface.RESET_SCENE),
            (Demonstrate, interface.DEMONSTRATE),
        ):
            Action(probe.node, kind, name, lambda id, goal: Answer(Code.DONE))
        probe.node.create_service(SetBool, interface.RECORD, self._record)
        self._master, slave = pty.openpty()
        parameters = {
            "demonstrations": 3,
            "series": str(self.file),
            "person": False,
            "review": True,
            "bell": True,
            "body": "",
            "state_topic": "/states",
        }
        command = [sys.executable, "-m", "wam_power_ros.console.teach", "--ros-args"]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={json.dumps(value)}"]
        self.process = subprocess.Popen(
            command, env=processes.environment, stdin=slave, stdout=slave, stderr=slave
        )
        os.close(slave)
        os.set_blocking(self._master, False)

    def _record(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        bag = self._folder / "bags" / f"demo_{self._recorded}"
        if not request.data:
            demonstration(bag, random_q(5))
            self._recorded += 1
        response.success, response.message = True, str(bag)
        return response

    def read(self) -> str:
        """Everything printed so far."""
        try:
            self.text += os.read(self._master, 65536).decode()
        except OSError:  # nothing new, or closed
            pass
        return self.text

    def press(self, key: str, takes: int) -> None:
        """Press a key and Enter at the prompt after take number `takes`."""
        self._probe.until(lambda: self.read().count("Enter: keep") == takes, "a prompt")
        os.write(self._master, f"{key}\n".encode())

    def ended(self) -> int:
        """Exit status."""
        self._probe.until(lambda: self.read() and self.process.poll() is not None, "the end")
        return self.process.returncode

    def kept(self) -> list[str]:
        """Names of the bags of the series."""
        return [bag.name for bag in series.read(self.file)]


def _done(_: object, response: Trigger.Response) -> Trigger.Response:
    response.success = True
    return response


@pytest.fixture
def terminal(
    probe: Probe, processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Terminal]:
    """Teaching in progress."""
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import JointState

    series.write(tmp_path / series.FILE, [demonstration(tmp_path / "bags/old", random_q(5))])
    recorder = subprocess.Popen(  # teaching waits for it before the first take
        [sys.executable, "-c", RECORDER], env=processes.environment
    )
    probe.publisher(JointState, "/states", QoSProfile(depth=1))
    terminal = Terminal(probe, processes, tmp_path)
    yield terminal
    for process in (terminal.process, recorder):
        process.kill()
        process.wait()


RECORDER = """
import rclpy
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node("demonstration_recorder")
node.create_subscription(JointState, "/states", lambda message: None, 1)
rclpy.spin(node)
"""


def test_takes_are_kept_repeated_and_discarded_and_the_series_is_ended(terminal: Terminal) -> None:
    terminal.press("a", 1)  # repeat
    terminal.press("", 2)
    terminal.press("what?", 3)  # asked again
    terminal.press("d", 4)  # not repeated
    terminal.press("q", 5)  # also the last one requested
    assert terminal.ended() == 0, terminal.text
    assert terminal.kept() == ["old", "demo_1", "demo_3"]
    trash = terminal.file.parent / "bags" / series.TRASH
    assert sorted(bag.name for bag in trash.iterdir()) == ["demo_0", "demo_2"]
    assert terminal.text.count("\a") == 8  # start and end of each take


def test_takes_before_ctrl_c_are_in_the_series(terminal: Terminal) -> None:
    terminal.press("", 1)
    terminal.press("", 2)
    terminal._probe.until(lambda: terminal.read().count("Enter: keep") == 3, "a prompt")
    terminal.process.send_signal(signal.SIGINT)
    assert terminal.ended() != 0
    assert terminal.kept() == ["old", "demo_0", "demo_1", "demo_2"]
