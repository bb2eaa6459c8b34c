# SPDX-License-Identifier: Apache-2.0
"""`wam-power` in a terminal whose environment is set for a robot, invalid, or missing."""

from __future__ import annotations

import fcntl
import os
import shutil
import signal
import subprocess
import sys
from collections import namedtuple
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from bag_samples import REACH
from conftest import Probe, python_path
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from toss_task import demonstrated_policy

from wam_power_ros.bags import series
from wam_power_ros.cli import main
from wam_power_ros.cli.plan import DOMAIN_FILE
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface
from wam_power_ros.ros.domain import private_domain

LEARN = [sys.executable, "-m", "wam_power_ros.cli", "learn"]
HOLDING = """
import sys
from wam_power_ros.ros.domain import hold
lock = hold(int(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


def terminal(words: list[str], folder: Path, **environment: str) -> subprocess.Popen[bytes]:
    """A command in a terminal of its own, with its output in `terminal.log`."""
    with (folder / "terminal.log").open("wb") as output:
        return subprocess.Popen(
            words,
            cwd=folder,
            env=os.environ | {"PYTHONPATH": python_path(), "MUJOCO_GL": "disable"} | environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )


def said(folder: Path) -> str:
    return (folder / "terminal.log").read_text(errors="replace")


@pytest.mark.requirement("S-55")
def test_no_torque_of_a_simulation_reaches_a_driver_in_the_exported_domain(
    probe: Probe, domain_id: int, tmp_path: Path
) -> None:
    """In a terminal without HOME and UTF-8, with a session of an odd name."""
    torques = probe.listen(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND)
    others = probe.listen(JointState, interface.JOINT_STATES, interface.STATE_RECORD)
    states = probe.node.create_publisher(JointState, "/joint_states", interface.STATE_OUT)
    names = [f"right_j{number}" for number in range(1, 8)]
    folder = tmp_path / 'it\'s "a" té$t'
    words = ["--task", "reach", "--preset", "full", "--session", folder.name, "--bags", str(REACH)]
    with pytest.MonkeyPatch.context() as without:
        without.delenv("HOME", raising=False)
        without.delenv("ROS_LOG_DIR", raising=False)
        ascii = {"LC_ALL": "C", "PYTHONIOENCODING": "ascii"}
        learning = terminal([*LEARN, *words], tmp_path, ROS_DOMAIN_ID=str(domain_id), **ascii)
    try:

        def standing() -> bool:  # a driver of an arm that stands still
            message = JointState(name=names, position=[0.0] * 7, velocity=[0.0] * 7)
            message.header.stamp = probe.node.get_clock().now().to_msg()
            states.publish(message)
            return (folder / "rollouts.jsonl").exists() or learning.poll() is not None

        probe.until(standing, "a rollout of the simulation", 120.0)
        assert learning.poll() is None, said(tmp_path)
        chosen = int((folder / "logs" / DOMAIN_FILE).read_text())
        learning.send_signal(signal.SIGINT)
        probe.until(lambda: learning.poll() is not None, "its end", 60.0)
    finally:
        learning.kill()
    assert torques == []
    assert {tuple(message.name) for message in others} == {tuple(names)}
    assert chosen != domain_id
    assert f"export ROS_DOMAIN_ID={chosen}" in said(tmp_path)
    assert learning.returncode == 130
    assert "Traceback" not in said(tmp_path) and "Error" not in said(tmp_path)


@pytest.fixture
def domain_in_use(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """An exported domain that another process holds."""
    with private_domain() as free:
        pass
    command = [sys.executable, "-c", HOLDING, str(free)]
    environment = os.environ | {"PYTHONPATH": python_path()}
    with subprocess.Popen(
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as holding:
        assert holding.stdout is not None and holding.stdout.readline() == b"held\n"
        monkeypatch.setenv("ROS_DOMAIN_ID", str(free))
        yield free


@pytest.mark.requirement("S-55")
def test_a_session_on_an_arm_is_refused_in_the_domain_of_another(
    domain_in_use: int, refusal: Callable[..., str]
) -> None:
    message = refusal("learn", "--session", "s", "--config", "geodude")
    assert f"DDS domain {domain_in_use} is in use on this machine" in message


@pytest.mark.parametrize("lock", [".lock", "logs/.lock"], ids=["a learner", "a launcher"])
def test_a_second_learn_is_refused_before_it_writes_anything(
    lock: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "s"
    (folder / "logs").mkdir(parents=True)
    (folder / "logs" / DOMAIN_FILE).write_text("42\n")
    (folder / "logs" / "parameters.yaml").write_text("# of the first\n")
    with (folder / lock).open("a") as first:
        fcntl.flock(first, fcntl.LOCK_EX)
        assert main.main(["learn", "--session", str(folder)]) == 2
    out, err = capsys.readouterr()
    assert "another session or learner is using" in err
    assert out == ""  # no word of a beginning before a refusal
    assert (folder / "logs" / DOMAIN_FILE).read_text() == "42\n"
    assert (folder / "logs" / "parameters.yaml").read_text() == "# of the first\n"


@pytest.mark.parametrize(
    ("words", "budget"),
    [
        (["--trials", "1", "--demonstrations", "1"], 1),
        (["--trials", "2", "--bags", "a", "b"], 2),
    ],
)
def test_too_few_trials_are_refused_before_anybody_teaches(
    words: list[str], budget: int, refusal: Callable[..., str]
) -> None:
    message = f"a budget of {budget} rollouts leaves none to practise"
    assert message in (said := refusal("learn", *words))
    assert f"allow {budget + 1} trials or more" in said


def test_demonstrations_that_are_taught_already_count_against_the_trials(
    tmp_path: Path, refusal: Callable[..., str]
) -> None:
    taught = [tmp_path / "s/bags" / name for name in "abcde"]
    (tmp_path / "s").mkdir()
    series.write(tmp_path / "s" / series.FILE, taught)
    said = refusal("learn", "--session", "s", "--trials", "5")
    assert "after 5 reproductions of demonstrations: allow 6 trials or more" in said
    assert [path.name for path in (tmp_path / "s").iterdir()] == [series.FILE]  # nothing started


def test_a_learner_that_cannot_work_is_refused_before_anybody_teaches(
    refusal: Callable[..., str],
) -> None:
    said = refusal("learn", "--session", "s", "--preset", "paper", "--learner", "model_based")
    assert "'model_based' needs a model of the vector error" in said
    working = said.strip().rpartition(": ")[2].split(", ")
    assert "power" in working and "model_based" not in working


def test_a_session_that_was_begun_with_a_learner_that_cannot_work_is_not_resumed(
    tmp_path: Path, refusal: Callable[..., str]
) -> None:
    settings = preset("flip", "paper", {"name": "model_based"})
    Session.begin(tmp_path / "s", settings, 0, [demonstrated_policy()]).close()
    said = refusal("learn", "--session", "s")
    assert "s cannot go on: learner 'model_based' needs" in said
    assert "Begin another session" in said and not (tmp_path / "s/logs").exists()


@pytest.mark.parametrize("command", ["learn", "teach"])
def test_a_full_disk_is_an_error_before_anybody_teaches(
    command: str, refusal: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "total used free")(10**9, 8 * 10**8, 2 * 10**8)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    assert "200 MB free on the disk of" in refusal(command)


def test_a_session_on_an_arm_refuses_an_invalid_domain(
    refusal: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "300")
    message = refusal("teach", "--config", "geodude")
    assert "ROS_DOMAIN_ID='300' is not a whole number" in message
