# SPDX-License-Identifier: Apache-2.0
"""The process beside the torque controller: neither its work nor its end delays the loop."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from conftest import ROOT, Probe, Processes, lift, python_path
from control_msgs.action import FollowJointTrajectory
from played_arm import HOME, NAMES, PlayedArm
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from wam_power_interfaces.action import ExecutePolicy
from wam_power_interfaces.msg import Policy as PolicyMessage
from wam_power_ros import plain_json
from wam_power_ros.client.actions import Action
from wam_power_ros.client.link import Link
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.safety import limits_of
from wam_power_ros.learning.policy import COUNT_MAX, DURATION_MAX, Basis, Policy, to_json
from wam_power_ros.nodes import preparation
from wam_power_ros.nodes.preparation import Preparation, settings_of, settings_values
from wam_power_ros.nodes.preparation_worker import followed
from wam_power_ros.regions import Region
from wam_power_ros.ros import interface, joint_messages, process_channel
from wam_power_ros.ros.outcomes import Answer, Code


def largest_policy() -> str:
    """Text of a policy of as many spring-dampers over as long a time as are allowed."""
    rng = np.random.default_rng(1)
    spread = rng.uniform(-1.0, 1.0, (COUNT_MAX, 3, 3))
    policy = Policy(
        id="largest",
        basis=Basis(COUNT_MAX, DURATION_MAX, 0.1),
        stiffness=300.0 * np.eye(3) + spread + spread.transpose(0, 2, 1),
        attractors=rng.uniform(0.3, 0.6, (COUNT_MAX, 3)),
        damping=32.0,
        orientation_reference=np.array([0.0, 0.0, 0.0, 1.0]),
        rotation_attractors=rng.uniform(-0.1, 0.1, (COUNT_MAX, 3)),
        rotation_stiffness=400.0,
        rotation_damping=36.0,
        q_start=HOME,
    )
    return to_json(policy)


class Worker:
    """The preparation process of a torque controller."""

    def __init__(self, arm: PlayedArm) -> None:
        self._controller = arm.process.pid
        self.pid = self.find()

    def find(self) -> int:
        """Id of the process; 0 when there is none."""
        of = Path(f"/proc/{self._controller}/task/{self._controller}/children").read_text().split()
        return int(of[-1]) if of else 0

    @property
    def blocked(self) -> int:
        """Mask of the signals that the process blocks."""
        status = Path(f"/proc/{self.pid}/status").read_text()
        return int(status.partition("SigBlk:")[2].split()[0], 16)

    def signal(self, number: int) -> None:
        """Send a signal to the process."""
        os.kill(self.pid, number)


@pytest.fixture
def worker(arm: PlayedArm) -> Iterator[Worker]:
    worker = Worker(arm)
    yield worker
    if worker.find() == worker.pid:
        worker.signal(signal.SIGCONT)


def answered(arm: PlayedArm, count: int = 25) -> None:
    for _ in range(count):
        arm.send()
        assert arm.answer().label == "hold"


@pytest.mark.requirement("S-54")
def test_the_loop_waits_neither_for_a_policy_nor_for_a_log_and_stop_is_obeyed_at_once(
    shared_nodes: tuple[Probe, Processes], arm: PlayedArm, worker: Worker
) -> None:
    probe, processes = shared_nodes
    refused = probe.ask("execute", "{")
    assert probe.answer(refused).code is Code.REFUSED  # so both have been discovered
    probe.spin(1.2)  # its log allows another line
    worker.signal(signal.SIGSTOP)
    arm.send(q=np.append(HOME[:6], math.nan))  # the first refusal, which is logged
    answered(arm)
    execute = probe.ask("execute", lift("slow"))
    probe.spin(0.3)
    answered(arm)
    assert probe.call(Trigger, interface.STOP).success
    answered(arm)
    assert not execute.begun
    worker.signal(signal.SIGCONT)
    answer = probe.answer(execute)
    assert answer.code is Code.STOPPED and answer.stop
    answered(arm)  # a stopped rollout is not executed
    probe.until(lambda: "must be finite" in processes.output(arm.process), "the log")


@pytest.mark.requirement("S-54")
def test_an_arm_that_a_person_takes_does_not_move_on_a_request_that_was_sent_before(
    arm: PlayedArm, worker: Worker
) -> None:
    probe = arm.probe
    assert not probe.answer(probe.ask("move_to_start", "{")).success
    worker.signal(signal.SIGSTOP)
    move = probe.ask("move_to_start", lift("late"))
    probe.spin(0.3)
    free = SetBool.Request(data=True)
    assert probe.call(SetBool, interface.GRAVITY_COMPENSATION, free).success
    worker.signal(signal.SIGCONT)
    assert probe.answer(move, arm.send).code is Code.STOPPED
    for _ in range(25):
        arm.send()
        assert arm.answer().label == "gravity_compensation"


@pytest.mark.requirement("S-54")
def test_a_killed_process_is_started_again_and_the_policy_in_force_stays(
    arm: PlayedArm, worker: Worker
) -> None:
    probe = arm.probe
    for number in (signal.SIGINT, signal.SIGTERM):  # only the controller acts on them
        assert worker.blocked >> (number - 1) & 1
    moved = probe.ask("move_to_start", lift("loaded"))
    arm.diagnosis(lambda d: arm.send() or d["policy"] == "loaded", "the policy")
    assert probe.answer(moved, arm.send).success
    with Link(rclpy.create_node("client", context=probe.context)) as link:
        execution = Action(link, ExecutePolicy, interface.EXECUTE_POLICY)
        goal = execution.send(policy=PolicyMessage(text=largest_policy()))
        worker.signal(signal.SIGKILL)  # it takes longer to prepare
        answered(arm)
        probe.until(lambda: arm.send() or goal.ended, "the end of the goal")
        assert goal.answer.code is Code.UNKNOWN  # to the client, within seconds
    assert worker.find() not in (0, worker.pid)
    report = arm.diagnosis(lambda d: arm.send() or d["preparation processes"] != "1", "the report")
    assert report["policy"] == "loaded" and report["mode"] == "hold"

    def executed() -> bool:
        """Whether a goal of a policy begins: the one before may have gone to the killed process."""
        execute = probe.ask("execute", lift("loaded"))
        probe.until(lambda: arm.send() or execute.begun, "the rollout", 10.0)
        return bool(execute.stages)

    assert executed()


@pytest.mark.requirement("S-54")
def test_a_robot_description_is_read_before_the_loop_runs_and_not_in_it(
    probe: Probe, processes: Processes
) -> None:
    descriptions = probe.publisher(
        String, interface.ROBOT_DESCRIPTION, interface.LATCHED, readers=0
    )
    arm = PlayedArm(probe, processes, urdf='""')
    probe.until(descriptions.get_subscription_count, "a reader")
    descriptions.publish(String(data=(ROOT / "urdf/wam7.urdf").read_text()))
    arm.activate()
    probe.until(lambda: not descriptions.get_subscription_count(), "no reader any more")
    answered(arm)


@pytest.mark.requirement("S-54")
def test_a_policy_above_its_size_is_refused_unread(arm: PlayedArm) -> None:
    sent = arm.probe.ask("execute", "{" * (plain_json.SIZE_MAX + 1))
    large = arm.probe.answer(sent, arm.send)
    assert large.code is Code.REFUSED and f"{plain_json.SIZE_MAX + 1} bytes" in large.text


@pytest.mark.requirement("S-54")
def test_a_long_movement_is_replayed_and_one_too_fast_refused_when_it_is_asked_for(
    arm: PlayedArm,
) -> None:
    probe = arm.probe
    t = np.arange(0.0, 13.0, 0.01)  # 13 s
    sway = HOME + 0.1 * np.sin(t)[:, None]

    def asked(stretched: float) -> Answer | None:
        moved = joint_messages.JointMovement(stretched * t, sway)
        replay = probe.replay(joint_messages.movement_message(NAMES, moved))
        labels = set()
        while replay.result is None and "replay" not in labels:
            arm.send()
            labels.add(arm.answer().label)
        assert "fault" not in labels
        return replay.answer

    refusal = asked(0.01)
    assert refusal.code is Code.TOO_FAST and 0.0 < refusal.speed < 1.0
    assert asked(1.0) is None  # it is under way
    assert probe.call(Trigger, interface.STOP).success


@pytest.mark.requirement("S-54")
def test_a_request_that_a_process_died_of_is_refused_and_another_process_is_started(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(preparation, "MODULE", "dying_preparation")
    monkeypatch.setattr(preparation, "RESTART_PERIOD", 0.0)
    monkeypatch.setenv("PYTHONPATH", python_path(ROOT, ROOT / "test"))
    lost: list[tuple[str, str]] = []
    beside = Preparation(0, _never, _never, _never, lambda *request: lost.append(request))
    beside.configure(None, ())
    end = time.monotonic() + 60.0
    while len(lost) < 2 and time.monotonic() < end:
        beside.restart_if_ended()
        beside.poll()
        time.sleep(0.01)
    assert [id for id, _ in lost] == ["7", "7"] and "has ended" in lost[0][1]
    assert beside.starts >= 2
    beside.close()


HANGS = """
import time
from wam_power_ros.nodes import preparation_worker as worker
worker.END_TIMEOUT = 0.5
worker.main()
time.sleep(600.0)  # as a middleware whose end waits for ever
"""


@pytest.mark.requirement("S-54")
def test_a_process_whose_end_hangs_does_not_stay_beside_the_next_controller(
    processes: Processes,
) -> None:
    ours, theirs = process_channel.pair()
    actions = [(os.POSIX_SPAWN_DUP2, theirs.fileno(), preparation.CHANNEL)]
    command = [sys.executable, "-c", HANGS]
    pid = os.posix_spawn(sys.executable, command, processes.environment, file_actions=actions)
    theirs.close()
    ours.close()  # the controller has ended
    end, ended = time.monotonic() + 60.0, 0
    while not ended and time.monotonic() < end:
        ended, _ = os.waitpid(pid, os.WNOHANG)
        time.sleep(0.05)
    if not ended:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    assert ended == pid


def test_settings_arrive_as_they_were() -> None:
    arm = Arm((ROOT / "urdf/wam7.urdf").read_text(), NAMES)
    region = Region("box", (0.1, 0.2, 0.3), 0.05)
    settings = ControllerSettings(limits=limits_of(arm), region=region, arm=arm.identity())
    text = json.dumps(settings_values(settings))
    values = json.loads(text)
    assert json.dumps(settings_values(settings_of(values))) == text
    assert settings_of(values).arm == settings.arm and settings_of(values).region == region
    assert settings_of(values).limits.q_max.tolist() == settings.limits.q_max.tolist()


def test_a_trajectory_that_never_began_is_an_invalid_goal_and_one_that_ended_early_is_not() -> None:
    invalid, early = FollowJointTrajectory.Result.INVALID_GOAL, {Code.FAULT, Code.STOPPED}
    for code in Code:
        result = followed(Answer(code, "why"))
        expected = -4 if code in early else 0 if code is Code.DONE else invalid
        assert (result.error_code, result.error_string) == (expected, "why")


def _never(*values: object) -> None:
    pytest.fail(f"{values} was handed over")
