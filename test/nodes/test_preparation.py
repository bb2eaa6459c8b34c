# SPDX-License-Identifier: Apache-2.0
"""The process beside the torque controller: neither its work nor its end delays the loop."""

from __future__ import annotations

import json
import math
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Probe, Processes, lift
from played_arm import HOME, NAMES, PlayedArm
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.safety import limits_of
from wam_power_ros.learning.policy import SIZE_MAX, to_json
from wam_power_ros.nodes import preparation, preparation_worker
from wam_power_ros.nodes.preparation import (
    MOVEMENT,
    POLICY,
    Preparation,
    settings_of,
    settings_values,
)
from wam_power_ros.regions import Region
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.answers import Answer, Code, read


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
def arm(probe: Probe, processes: Processes) -> PlayedArm:
    arm = PlayedArm(probe, processes)
    arm.activate()
    return arm


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
    probe: Probe, processes: Processes, arm: PlayedArm, worker: Worker
) -> None:
    policies = probe.publisher(String, interface.POLICY, interface.LATCHED)
    worker.signal(signal.SIGSTOP)
    policies.publish(String(data=to_json(lift("slow"))))
    arm.send(q=np.append(HOME[:6], math.nan))  # the first refusal, which is logged
    answered(arm)
    execute = probe.begin(Trigger, interface.EXECUTE)
    probe.spin(0.3)
    answered(arm)
    assert not execute.done()
    assert probe.call(Trigger, interface.STOP).success
    assert read(execute.result().success, execute.result().message).code is Code.STOPPED
    worker.signal(signal.SIGCONT)
    arm.diagnosis(lambda d: d["policy"] == "slow", "the policy is loaded")
    answered(arm, 1)  # a stopped rollout is not executed
    probe.until(lambda: "must be finite" in processes.output(arm.process), "the log")


@pytest.mark.requirement("S-54")
def test_a_request_uses_the_policy_that_was_published_before_it(
    probe: Probe, arm: PlayedArm, worker: Worker
) -> None:
    policies = probe.publisher(String, interface.POLICY, interface.LATCHED)
    policies.publish(String(data=to_json(lift("before"))))
    # Messages from before the discovery of publisher and reader have no order.
    arm.diagnosis(lambda d: d["policy"] == "before", "the publisher has been found")
    for name in ("first", "second", "third"):
        worker.signal(signal.SIGSTOP)
        policies.publish(String(data=to_json(lift(name))))
        future = probe.begin(Trigger, interface.EXECUTE)
        probe.spin(0.1)
        worker.signal(signal.SIGCONT)
        probe.until(future.done, "the answer")
        answer = read(future.result().success, future.result().message)
        assert answer.success and answer.values["policy"] == name
        assert probe.call(Trigger, interface.STOP).success
        answered(arm, 100)  # until the arm holds and rests


@pytest.mark.requirement("S-54")
def test_a_killed_process_is_started_again_and_the_policy_in_force_stays(
    probe: Probe, arm: PlayedArm, worker: Worker
) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):  # only the controller acts on them
        assert worker.blocked >> (number - 1) & 1
    older, newer = (probe.publisher(String, interface.POLICY, interface.LATCHED) for _ in range(2))
    for publisher, name in ((older, "older"), (newer, "newer")):
        publisher.publish(String(data=to_json(lift(name))))
        arm.diagnosis(lambda d, n=name: d["policy"] == n, f"policy {name}")
    worker.signal(signal.SIGSTOP)
    move = probe.begin(Trigger, interface.MOVE_TO_START)
    probe.spin(1.0)  # until the controller has received the request, on a busy machine too
    worker.signal(signal.SIGKILL)
    probe.until(move.done, "the answer")
    refusal = read(move.result().success, move.result().message)
    assert refusal.code is Code.BUSY and "has ended" in refusal.text
    answered(arm)

    def again() -> bool:
        arm.send()
        probe.spin(0.02)
        return worker.find() not in (0, worker.pid)

    probe.until(again, "another process")
    report = arm.diagnosis(lambda d: d["preparation processes"] == "2", "it is reported")
    probe.until(
        lambda: newer.get_subscription_count() and older.get_subscription_count(), "readers"
    )
    answer = probe.call(Trigger, interface.EXECUTE)  # waits until latched policies have been read
    assert read(answer.success, answer.message).values["policy"] == "newer"
    assert report["policy"] == "newer" and report["mode"] == "hold"


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
def test_a_message_above_its_size_is_refused_unread(probe: Probe, arm: PlayedArm) -> None:
    policies = probe.publisher(String, interface.POLICY, interface.LATCHED)
    policies.publish(String(data="{" * (SIZE_MAX + 100)))
    report = arm.diagnosis(lambda d: d.get(f"refused: {POLICY}") == "1", "the policy's refusal")
    assert f"at most {preparation_worker.SIZE_MAX[POLICY]} allowed" in report["last refusal"]
    movements = probe.publisher(JointTrajectory, interface.REPLAY_TRAJECTORY, interface.LATCHED)
    large = "x" * preparation_worker.SIZE_MAX[MOVEMENT]
    movements.publish(JointTrajectory(joint_names=[large]))
    report = arm.diagnosis(lambda d: d.get(f"refused: {MOVEMENT}") == "1", "the other refusal")
    assert f"at most {preparation_worker.SIZE_MAX[MOVEMENT]} allowed" in report["last refusal"]


@pytest.mark.requirement("S-54")
def test_a_long_movement_is_replayed_and_one_too_fast_refused_when_it_is_asked_for(
    probe: Probe, arm: PlayedArm
) -> None:
    movements = probe.publisher(JointTrajectory, interface.REPLAY_TRAJECTORY, interface.LATCHED)
    t = np.arange(0.0, 13.0, 0.01)  # 13 s
    sway = HOME + 0.1 * np.sin(t)[:, None]

    def asked(stretched: float) -> Answer | None:
        moved = joint_messages.JointMovement(stretched * t, sway)
        movements.publish(joint_messages.movement_message(NAMES, moved))
        replay = probe.begin(Trigger, interface.REPLAY)
        labels = set()
        while not replay.done() and "replay" not in labels:
            arm.send()
            labels.add(arm.answer().label)
        assert "fault" not in labels
        if not replay.done():
            return None
        return read(replay.result().success, replay.result().message)

    def insisted(stretched: float) -> Answer | None:
        answer, end = asked(stretched), time.monotonic() + 60.0
        while answer is not None and answer.code in (Code.NOTHING, Code.BUSY):  # not read yet
            assert time.monotonic() < end, answer
            answer = asked(stretched)
        return answer

    refusal = insisted(0.01)
    assert refusal.code is Code.TOO_FAST and 0.0 < float(refusal.values["speed"]) < 1.0
    assert insisted(1.0) is None  # it is under way
    assert probe.call(Trigger, interface.STOP).success


@pytest.mark.requirement("S-54")
def test_what_a_process_died_of_is_refused_and_not_read_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(preparation, "MODULE", "dying_preparation")
    monkeypatch.setattr(preparation, "RESTART_PERIOD", 0.0)
    monkeypatch.setattr(preparation, "READ_TIMEOUT", 60.0)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), str(ROOT / "test")]))
    refused: list[tuple[str, str]] = []
    reasons: list[str | None] = []
    beside = Preparation(0, _never, _never, lambda *refusal: refused.append(refusal))
    beside.configure(None, ())
    beside.when_read(reasons.append)

    def refusals(count: int) -> list[tuple[str, str]]:
        end = time.monotonic() + 60.0
        while len(refused) < count and time.monotonic() < end:
            beside.tend()
            beside.poll()
            time.sleep(0.01)
        return refused

    assert refusals(1)[0][0] == POLICY and "has ended" in refused[0][1]
    assert reasons == [refused[0][1]]
    refusals(2)
    assert beside.starts == 2
    assert refused[1] == ("seen", "[['policy', 7]]")
    beside.close()


def test_settings_arrive_as_they_were() -> None:
    arm = Arm((ROOT / "urdf/wam7.urdf").read_text(), NAMES)
    region = Region("box", (0.1, 0.2, 0.3), 0.05)
    settings = ControllerSettings(limits=limits_of(arm), region=region, arm=arm.identity())
    text = json.dumps(settings_values(settings))
    values = json.loads(text)
    assert json.dumps(settings_values(settings_of(values))) == text
    assert settings_of(values).arm == settings.arm and settings_of(values).region == region
    assert settings_of(values).limits.q_max.tolist() == settings.limits.q_max.tolist()


def _never(value: object) -> None:
    pytest.fail(f"{value} was handed over")
