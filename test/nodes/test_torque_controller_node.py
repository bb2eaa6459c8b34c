# SPDX-License-Identifier: Apache-2.0
"""The torque controller over real DDS: the test plays the arm, state by state."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Probe, Process, Processes, lift
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from played_arm import HOME, MODULE, NAMES, TICK, PlayedArm
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.policy import to_json, with_id
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.outcomes import Answer, Code
from wam_power_ros.ros.requests import Request, RolloutEnd


@pytest.mark.requirement("S-03")
def test_each_state_gets_one_torque_labelled_with_its_stamp(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes)
    arm.activate()
    seen = len(arm.read())
    stamps = []
    for _ in range(50):
        arm.send()
        stamps.append(arm.stamp_ns)
        arm.answer()
    probe.spin(0.1)
    assert [torque.stamp_ns for torque in arm.read()[seen:]] == stamps
    tau = arm.torques[-1].tau
    gravity = Arm((ROOT / "urdf/wam7.urdf").read_text(), NAMES).gravity(HOME)
    np.testing.assert_allclose(tau, gravity, atol=1e-9)


@pytest.mark.requirement("S-12")
def test_names_in_any_order_beside_others_give_the_same_torque(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes)
    arm.activate()
    arm.send()
    expected = arm.answer().tau
    order = [3, 6, 0, 2, 5, 1, 4]
    arm.send([*(NAMES[i] for i in order), "finger"], np.append(HOME[order], 9.0))
    assert arm.answer().tau.tolist() == expected.tolist()


@pytest.mark.requirement("S-03")
def test_a_repeated_stamp_gets_the_same_torque_and_an_older_one_none(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes)
    arm.activate()
    arm.send()
    first = arm.answer()
    arm.again(NAMES, HOME + 0.01, np.zeros(7))
    probe.until(lambda: [t.stamp_ns for t in arm.read()].count(arm.stamp_ns) == 2, "the repetition")
    assert arm.torques[-1].tau.tolist() == first.tau.tolist()
    count = len(arm.torques)
    arm.stamp_ns -= 3 * TICK
    arm.again(NAMES, HOME, np.zeros(7))
    probe.spin(0.3)
    assert len(arm.read()) == count


@pytest.mark.requirement("S-14")
def test_states_without_velocity_get_torques_too(probe: Probe, processes: Processes) -> None:
    arm = PlayedArm(probe, processes)
    arm.activate()
    arm.send()
    expected = arm.answer().tau
    for qd in (np.empty(0), np.full(7, math.nan)):
        arm.send(qd=qd)
        assert arm.answer().tau.tolist() == expected.tolist()


@pytest.mark.requirement("S-15")
def test_a_bad_policy_is_refused_whole_and_the_good_one_stays(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes)
    arm.activate()

    def asked(do: str, text: str) -> Answer:
        answers = probe.ask(do, text)
        return probe.until(lambda: arm.send() or answers, "an answer")[0]

    moved = probe.ask("move_to_start", to_json(lift("good")))
    probe.until(lambda: arm.send() or len(moved) == 2, "the end of the move")
    assert [answer.code for answer in moved] == [Code.BEGUN, Code.DONE]
    bad = to_json(with_id(lift("good"), "bad")).replace("300.0", "NaN", 1)
    stiff = to_json(with_id(lift("good"), "stiff")).replace("300.0", "9e9")
    for count, text in enumerate((bad, "{", stiff), start=1):  # each is taken before the next
        assert asked("execute", text).code is Code.REFUSED
        report = arm.diagnosis(lambda d, n=str(count): d.get("refused: request") == n, "a refusal")
    assert report["policy"] == "good"
    assert asked("execute", to_json(lift("good"))) == Answer(Code.BEGUN, values={"policy": "good"})


def test_a_state_that_is_repeated_in_lockstep_is_recent_at_a_late_activation(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes, autostart=False)

    def change(transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return probe.call(ChangeState, "/torque_controller/change_state", request).success

    assert change(Transition.TRANSITION_CONFIGURE)
    arm.send()
    end = time.monotonic() + 1.5
    while time.monotonic() < end:  # the stand-in waits for a torque before it steps
        arm.again(NAMES, HOME, np.zeros(7))
        probe.spin(0.05)
    assert change(Transition.TRANSITION_ACTIVATE)


def test_the_life_cycle_decides_whether_torques_are_sent(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes, autostart=False)

    def change(transition: int) -> bool:
        arm.send()
        request = ChangeState.Request(transition=Transition(id=transition))
        return probe.call(ChangeState, "/torque_controller/change_state", request).success

    answers = probe.ask("execute", lift("trial-0001"))
    probe.until(lambda: answers, "an answer")
    assert answers[0].code is Code.NOT_ACTIVE
    logged = lambda: processes.output(arm.process)  # noqa: E731
    waiting = "waiting for ros2 lifecycle set /torque_controller"
    probe.until(lambda: f"{waiting} configure" in logged(), "what it waits for")
    assert change(Transition.TRANSITION_CONFIGURE)
    probe.spin(1.2)
    assert not arm.read()
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVATE))
    refused = probe.call(ChangeState, "/torque_controller/change_state", request)
    assert not refused.success  # the last state is too old
    assert change(Transition.TRANSITION_ACTIVATE)
    arm.send()
    assert arm.answer().label == "hold"
    assert change(Transition.TRANSITION_DEACTIVATE)
    probe.until(lambda: arm.read()[-1].label == "inactive", "a last torque")
    count = len(arm.torques)
    for _ in range(20):
        arm.send()
    probe.spin(0.2)
    assert len(arm.read()) == count
    probe.until(lambda: f"{waiting} activate" in logged(), "what it waits for after that")
    modes = [line.rpartition("mode ")[2] for line in logged().splitlines() if ": mode " in line]
    assert modes == ["unconfigured", "inactive", "hold", "inactive"]
    assert change(Transition.TRANSITION_CLEANUP)


@pytest.mark.requirement("S-41")
def test_without_lockstep_a_short_silence_is_bridged_and_forgiven(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes, state_timeout=0.006, idle_service='""')
    for _ in range(600):
        arm.send()
        probe.spin(0.002)
    probe.until(lambda: arm.read() and arm.torques[-1].stamp_ns == arm.stamp_ns, "the answer")
    before = len(arm.read())
    probe.spin(0.012)
    arm.send()
    probe.spin(0.004)
    assert len(arm.read()) > before + 1  # torques for a state that had been answered already


@pytest.mark.requirement("S-04")
def test_a_driver_that_adds_gravity_is_sent_none(probe: Probe, processes: Processes) -> None:
    arm = PlayedArm(probe, processes, driver_compensates_gravity=True)
    arm.activate()
    arm.send()
    np.testing.assert_allclose(arm.answer().tau, 0.0, atol=1e-9)


def test_another_command_type_carries_the_same_torque(probe: Probe, processes: Processes) -> None:
    topic = "/joint_torque_commands"
    commands = probe.listen(JointState, topic, interface.COMMAND)
    arm = PlayedArm(probe, processes, command_type="joint_state", command_topic=topic)

    def commanded() -> bool:
        arm.send()
        probe.spin(0.05)
        return bool(commands) and commands[-1].header.frame_id == "hold"

    probe.until(commanded, "a command as a joint state")
    reading = joint_messages.torque(commands[-1], NAMES)
    assert reading.stamp_ns is not None
    assert np.isfinite(reading.tau).all()


def test_teaching_and_stopping_are_a_service_call_away(probe: Probe, processes: Processes) -> None:
    arm = PlayedArm(probe, processes)
    arm.activate()
    on = SetBool.Request(data=True)
    assert probe.call(SetBool, interface.GRAVITY_COMPENSATION, on).success
    arm.send()
    assert arm.answer().label == "gravity_compensation"
    answers = probe.ask("execute", lift("trial-0001"))
    assert not probe.until(lambda: answers, "an answer")[0].success
    assert probe.call(Trigger, interface.STOP).success
    arm.send()
    assert arm.answer().label == "hold"
    answers = probe.ask("wave", lift("trial-0001"))
    assert "not wave" in probe.until(lambda: answers, "an answer")[0].text


def test_each_request_is_answered_by_its_id_and_one_at_a_time(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes)
    arm.activate()
    first = probe.ask("move_to_start", lift("first"))
    arm.diagnosis(lambda values: values["mode"] == "move_to_start", "the move")
    second = probe.ask("move_to_start", lift("second"))
    assert probe.until(lambda: second, "an answer")[0].code is Code.BUSY
    probe.until(lambda: arm.send() or first[1:], "the end of the move")
    assert [answer.code for answer in first] == [Code.BEGUN, Code.DONE]
    assert first[1].values == {"policy": "first"} and len(second) == 1


def test_a_request_that_comes_again_is_answered_again_and_not_done_again(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes)
    arm.activate()
    request = Request("execute", {"policy": to_json(lift("once"))})

    def send() -> list[Answer]:
        return probe.send(String, "CONTROLLER_REQUEST", request.message(), request.id)

    answers = send()
    probe.until(lambda: arm.send() or answers, "the begin")
    assert probe.call(Trigger, interface.STOP).success
    probe.until(lambda: arm.send() or answers[1:], "the end of the rollout")
    end = RolloutEnd.of(answers[1])
    assert (end.id, end.fault) == ("once", None)
    for _ in range(100):
        arm.send()
        arm.answer()
    before = len(arm.read())
    send()
    probe.until(lambda: arm.send() or answers[2:], "an answer to the repetition")
    assert answers[2] == answers[1]
    for _ in range(20):
        arm.send()
        arm.answer()
    assert {torque.label for torque in arm.read()[before:]} == {"hold"}


def test_a_driver_may_name_its_joints_otherwise_than_the_model(
    probe: Probe, processes: Processes
) -> None:
    names = [f"q{i}" for i in range(1, 8)]
    arm = PlayedArm(probe, processes, joint_names=f"[{', '.join(names)}]")

    def answered() -> bool:
        arm.send(names)
        probe.spin(0.02)
        return bool(arm.read()) and arm.read()[-1].label == "hold"

    probe.until(answered, "the controller holds")


def test_in_simulated_time_states_may_stay_away(probe: Probe, processes: Processes) -> None:
    probe.publisher(Clock, interface.CLOCK, interface.CLOCK_QOS, readers=0)
    arm = PlayedArm(probe, processes, state_timeout=0.006, use_sim_time=True)
    arm.activate()
    count = len(arm.read())
    probe.spin(0.5)
    assert len(arm.read()) == count
    arm.send()
    assert arm.answer().label == "hold"


def test_a_recorded_movement_is_replayed_and_a_bad_one_refused(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes)
    arm.activate()
    t = np.linspace(0.0, 0.1, 6)
    still = joint_messages.JointMovement(t, np.tile(HOME, (6, 1)))
    few = joint_messages.movement_message(NAMES[:6], still._replace(q=still.q[:, :6]))
    refused = probe.replay(few)
    arm.diagnosis(lambda d: d.get("refused: replay trajectory") == "1", "the refusal is reported")
    assert refused[0].code is Code.REFUSED
    replay = probe.replay(joint_messages.movement_message(NAMES, still))
    labels = set()

    def done() -> bool:
        arm.send()
        labels.add(arm.answer().label)
        return len(replay) > 1

    probe.until(done, "the replay has ended")
    assert replay[1].success
    assert "rms" in replay[1].text
    assert "replay" in labels


@pytest.mark.requirement("S-18")
def test_a_missing_parameter_stops_the_node_and_is_named(
    processes: Processes, tmp_path: Path
) -> None:
    file = tmp_path / "incomplete.yaml"
    file.write_text("torque_controller: {ros__parameters: {autostart: true}}")
    process: Process = processes.node(MODULE, file)
    assert process.wait(60.0) == 2
    assert "joint_names" in processes.output(process)
