# SPDX-License-Identifier: Apache-2.0
"""`wam-power` in a terminal whose environment is set for a robot, invalid, or missing."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import namedtuple
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import pytest
from conftest import Probe, lift, python_path
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from toss_task import demonstrated_policy

from wam_power_ros.bags import layout, series
from wam_power_ros.cli.plan import DOMAIN_FILE
from wam_power_ros.learning.policy import to_json
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface
from wam_power_ros.ros.domain import private_domain


class Executed(NamedTuple):
    """A policy on the stand-in in a terminal with the domain of a robot, ended by Ctrl-C.

    Attributes:
        torques: Commands that have come in that domain.
        drivers: Joint names of all states there; that of the robot is the test.
        exported: That domain.
        folder: Path of what the command writes; its name has quotes, a blank and an accent.
        said: What it has printed.
        status: Its exit status.
    """

    torques: list[Float64MultiArray]
    drivers: set[tuple[str, ...]]
    exported: int
    folder: Path
    said: str
    status: int


RIGHT = tuple(f"right_j{number}" for number in range(1, 8))


@pytest.fixture(scope="module")
def executed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Executed]:
    """Without HOME and UTF-8."""
    place = tmp_path_factory.mktemp("terminal")
    folder, log = place / 'it\'s "a" té$t', place / "terminal.log"
    (place / "policy.json").write_text(to_json(lift("lift")))
    kept = {name: os.environ[name] for name in os.environ.keys() - {"HOME", "ROS_LOG_DIR"}}
    kept |= {"PYTHONPATH": python_path(), "LC_ALL": "C", "PYTHONIOENCODING": "ascii"}
    command = [sys.executable, "-m", "wam_power_ros.cli", "run-policy", "policy.json"]
    with private_domain() as domain, closing(Probe(domain)) as probe:
        torques = probe.listen(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND)
        others = probe.listen(JointState, interface.JOINT_STATES, interface.STATE_RECORD)
        states = probe.node.create_publisher(JointState, "/joint_states", interface.STATE_OUT)
        with log.open("wb") as output:
            running = subprocess.Popen(
                [*command, "--rollouts", "100", "--folder", folder.name],
                cwd=place,
                env=kept | {"ROS_DOMAIN_ID": str(domain)},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )

        def standing(text: str) -> bool:  # a driver of an arm that stands still
            message = JointState(name=RIGHT, position=[0.0] * 7, velocity=[0.0] * 7)
            message.header.stamp = probe.node.get_clock().now().to_msg()
            states.publish(message)
            return running.poll() is not None or (text != "" and text in log.read_text())

        try:
            probe.until(lambda: standing("1 of 100"), "the first rollout", 300.0)
            time.sleep(0.5)
            running.send_signal(signal.SIGINT)
            probe.until(lambda: standing(""), "the end of the command", 300.0)
        finally:
            running.kill()
        drivers, said = {tuple(message.name) for message in others}, log.read_text()
        yield Executed(torques, drivers, domain, folder, said, running.returncode)


@pytest.mark.requirement("S-55")
def test_no_torque_of_a_simulation_reaches_a_driver_in_the_exported_domain(
    executed: Executed,
) -> None:
    assert executed.torques == [] and executed.drivers == {RIGHT}
    chosen = int((executed.folder / "logs" / DOMAIN_FILE).read_text())
    assert chosen != executed.exported
    assert f"export ROS_DOMAIN_ID={chosen}" in executed.said
    assert "Traceback" not in executed.said


def test_each_rollout_has_its_return_and_ctrl_c_leaves_an_arm_that_holds_and_bags_closed(
    executed: Executed,
) -> None:
    said = executed.said
    assert executed.status == 130 and "Stopped: the arm holds." in said, said
    lines = re.findall(r"^(\d) of 100: return [\d.]+, .*recorded: (\w+)$", said, re.M)
    assert lines and lines[0][0] == "1", said
    bags = {path.name for path in (executed.folder / "bags").iterdir()}
    assert {bag for _, bag in lines} <= bags
    assert not [name for name in bags if name.endswith(layout.UNFINISHED)]


@pytest.mark.requirement("S-55")
def test_a_session_on_an_arm_is_refused_in_the_domain_of_another(
    refusal: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with private_domain() as held:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(held))
        message = refusal("learn", "--session", "s", "--config", "geodude")
    assert f"DDS domain {held} is in use on this machine" in message
    monkeypatch.setenv("ROS_DOMAIN_ID", "300")
    message = refusal("teach", "--config", "geodude")
    assert "ROS_DOMAIN_ID='300' is not a whole number" in message


def test_a_second_learn_is_refused_before_it_writes_anything(
    tmp_path: Path, refusal: Callable[..., str]
) -> None:
    (tmp_path / "s/logs").mkdir(parents=True)
    (of_the_first := tmp_path / "s/logs" / DOMAIN_FILE).write_text("42\n")
    for lock in (".lock", "logs/.lock"):  # of a learner, of a launcher
        with (tmp_path / "s" / lock).open("a") as first:
            fcntl.flock(first, fcntl.LOCK_EX)
            assert "another session or learner is using" in refusal("learn", "--session", "s")
    assert of_the_first.read_text() == "42\n"
    assert not (tmp_path / "s/logs/parameters.yaml").exists()


def test_a_learner_that_cannot_work_is_refused_in_a_new_session_and_in_one_that_was_begun(
    tmp_path: Path, refusal: Callable[..., str]
) -> None:
    said = refusal("learn", "--session", "n", "--preset", "paper", "--learner", "model_based")
    assert "'model_based' needs a model of the vector error" in said
    settings = preset("flip", "paper", {"name": "model_based"})
    Session.begin(tmp_path / "s", settings, 0, [demonstrated_policy()]).close()
    assert "s cannot go on: learner 'model_based' needs" in refusal("learn", "--session", "s")
    assert not (tmp_path / "s/logs").exists()
    (tmp_path / "taught").mkdir()
    series.write(
        tmp_path / "taught" / series.FILE, [tmp_path / "taught/bags" / name for name in "abcde"]
    )
    said = refusal("learn", "--session", "taught", "--trials", "5")
    assert "after 5 reproductions of demonstrations: allow 6 trials or more" in said


def test_a_full_disk_is_an_error_before_anybody_teaches(
    refusal: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "total used free")(10**9, 8 * 10**8, 2 * 10**8)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    assert "200 MB free on the disk of" in refusal("teach")
