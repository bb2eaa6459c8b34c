# SPDX-License-Identifier: Apache-2.0
"""The torque controller over real DDS: the test plays the arm, state by state."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from conftest import ROOT, Probe, Process, Processes, lift
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from played_arm import HOME, MODULE, NAMES, TICK, PlayedArm
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.policy import to_json
from wam_power_ros.nodes.preparation_worker import POINTS_MAX
from wam_power_ros.params.resources import share
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.diagnostics import LAST_STOP
from wam_power_ros.ros.outcomes import Code, Ended

ABORTED, CANCELED = GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED
SUCCEEDED = GoalStatus.STATUS_SUCCEEDED
JUMP = np.outer([0.0, 0.0, 0.0, 1.0, 1.0, 1.0], np.full(7, 0.3))  # [rad] in 20 ms
COBOT = Arm(
    share("urdf/cobot7.urdf").read_text(),
    [f"cobot_joint{i}" for i in range(1, 8)],
    "cobot_pan",
    guarded=(),
).identity()


@pytest.mark.requirement("S-03")
def test_each_state_gets_one_torque_labelled_with_its_stamp(arm: PlayedArm) -> None:
    probe = arm.probe
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
def test_names_in_any_order_beside_others_give_the_same_torque(arm: PlayedArm) -> None:
    arm.send()
    expected = arm.answer().tau
    order = [3, 6, 0, 2, 5, 1, 4]
    arm.send([*(NAMES[i] for i in order), "finger"], np.append(HOME[order], 9.0))
    assert arm.answer().tau.tolist() == expected.tolist()


@pytest.mark.requirement("S-03")
def test_a_repeated_stamp_gets_the_same_torque_and_an_older_one_none(arm: PlayedArm) -> None:
    probe = arm.probe
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
    arm.stamp_ns += 3 * TICK


@pytest.mark.requirement("S-14")
def test_states_without_velocity_get_torques_too(arm: PlayedArm) -> None:
    arm.send()
    expected = arm.answer().tau
    for qd in (np.empty(0), np.full(7, math.nan)):
        arm.send(qd=qd)
        assert arm.answer().tau.tolist() == expected.tolist()


def test_the_life_cycle_decides_whether_torques_are_sent_and_repeated_states_are_recent(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes, autostart=False)

    def change(transition: int) -> bool:
        arm.send()
        request = ChangeState.Request(transition=Transition(id=transition))
        return probe.call(ChangeState, "/torque_controller/change_state", request).success

    execute = probe.ask("execute", lift("trial-0001"))
    assert probe.answer(execute).code is Code.NOT_ACTIVE and execute.status == ABORTED
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
    assert change(Transition.TRANSITION_CONFIGURE)
    arm.send()
    end = time.monotonic() + 1.5
    while time.monotonic() < end:  # a stand-in in lockstep waits for a torque before it steps
        arm.again(NAMES, HOME, np.zeros(7))
        probe.spin(0.05)
    assert probe.call(ChangeState, "/torque_controller/change_state", request).success


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
    bridged = "torques for a state that had been answered already"
    probe.until(lambda: len(arm.read()) > before + 1, bridged)


@pytest.mark.requirement("S-04")
def test_a_driver_may_name_joints_otherwise_take_another_message_and_add_gravity_itself(
    probe: Probe, processes: Processes
) -> None:
    topic, names = "/joint_torque_commands", [f"q{i}" for i in range(1, 8)]
    commands = probe.listen(JointState, topic, interface.COMMAND)
    arm = PlayedArm(
        probe,
        processes,
        joint_names=f"[{', '.join(names)}]",
        command_type="joint_state",
        command_topic=topic,
        driver_compensates_gravity=True,
    )

    def commanded() -> bool:
        arm.send(names)
        probe.spin(0.05)
        return bool(commands) and commands[-1].header.frame_id == "hold"

    probe.until(commanded, "a command as a joint state")
    reading = joint_messages.torque(commands[-1], names)
    assert reading.stamp_ns is not None
    np.testing.assert_allclose(reading.tau, 0.0, atol=1e-9)


def test_teaching_and_stopping_are_a_service_call_away(arm: PlayedArm) -> None:
    probe = arm.probe
    on = SetBool.Request(data=True)
    assert probe.call(SetBool, interface.GRAVITY_COMPENSATION, on).success
    arm.send()
    assert arm.answer().label == "gravity_compensation"
    assert probe.answer(probe.ask("execute", lift("trial-0001")), arm.send).code is Code.BUSY
    assert probe.call(Trigger, interface.STOP).success
    arm.send()
    assert arm.answer().label == "hold"


def points(count: int) -> JointTrajectory:
    """A movement of so many points, which are not looked at."""
    return JointTrajectory(joint_names=NAMES, points=[JointTrajectoryPoint()] * count)


STILL = joint_messages.JointMovement(np.linspace(0.0, 0.1, 6), np.tile(HOME, (6, 1)))
GOOD = to_json(lift("good"))
WRONG = {  # of each kind: what is asked for, with what, code, and what is named
    "a policy that is none": ("execute", {"policy": "{"}, Code.REFUSED, "policy text"),
    "not a number": ("execute", {"policy": GOOD.replace("300.0", "NaN", 1)}, Code.REFUSED, "NaN"),
    "too stiff": ("execute", {"policy": GOOD.replace("300.0", "9e9")}, Code.REFUSED, "stiff"),
    "another id than its policy": (
        "execute",
        {"policy": lift("trial-0001"), "id": "trial-0002"},
        Code.REFUSED,
        "trial-0002",
    ),
    "a policy of another arm": (
        "move_to_start",
        {"policy": replace(lift("theirs"), arm=COBOT)},
        Code.REFUSED,
        "belongs to another arm: cobot7",
    ),
    "a start elsewhere": (
        "execute",
        {"policy": replace(lift("away"), q_start=HOME + 0.3)},
        Code.NOT_AT_START,
        "away",
    ),
    "a joint too few": (
        "replay",
        {"movement": joint_messages.movement_message(NAMES[:6], STILL._replace(q=STILL.q[:, :6]))},
        Code.REFUSED,
        "wam_j7",
    ),
    "another joint": (
        "replay",
        {"movement": joint_messages.movement_message([*NAMES[:6], "finger"], STILL)},
        Code.REFUSED,
        "wam_j7",
    ),
    "too many points": ("replay", {"movement": points(POINTS_MAX + 1)}, Code.REFUSED, "at most"),
    "no point": ("replay", {"movement": points(0)}, Code.REFUSED, "no point"),
    "a jump": (
        "replay",
        {"movement": joint_messages.movement_message(NAMES, STILL._replace(q=STILL.q + JUMP))},
        Code.TOO_FAST,
        "joint-speed limit",
    ),
}


@pytest.mark.requirement("S-15", "S-16")
def test_each_wrong_goal_ends_aborted_with_its_code_and_the_arm_holds(arm: PlayedArm) -> None:
    """And a refused policy does not replace the last that was accepted."""
    probe = arm.probe
    before = len(arm.read())
    for wrong, (do, goal, code, named) in WRONG.items():
        sent = probe.ask(do, **goal)
        answer = probe.answer(sent, arm.send)
        assert (answer.code, sent.status, sent.stages) == (code, ABORTED, []), (wrong, answer)
        assert named in answer.text and not answer.stop, (wrong, answer)
        assert (0.0 < answer.speed < 1.0) == (code is Code.TOO_FAST), (wrong, answer)
        if do == "execute":
            assert Ended.read(sent.result.end).start_ns == 0 and not sent.result.path.poses
    assert {torque.label for torque in arm.read()[before:]} == {"hold"}
    arm.diagnostics.clear()
    assert arm.diagnosis(lambda d: True, "a report")["policy"] == "away"


@pytest.mark.requirement("S-128")
def test_a_goal_that_a_person_stops_names_the_stop_and_one_that_knows_of_none_does_not_begin(
    arm: PlayedArm,
) -> None:
    probe = arm.probe
    arm.diagnostics.clear()
    known = arm.diagnosis(lambda d: True, "a report")[LAST_STOP] or "none"
    move = probe.ask("move_to_start", lift("trial-0001"), known_stop=known)
    probe.until(lambda: arm.send() or move.begun, "the move")
    assert probe.call(Trigger, interface.STOP).success
    stopped = probe.answer(move, arm.send)
    assert (stopped.code, move.status) == (Code.STOPPED, ABORTED)
    assert stopped.stop not in ("", known)
    arm.diagnosis(lambda d: d[LAST_STOP] == stopped.stop, "the stop")
    arm.settle()
    movement = joint_messages.movement_message(NAMES, STILL)
    for known in ("none", "another"):
        for do, goal in (
            ("execute", {"policy": lift("trial-0001")}),
            ("move_to_start", {"policy": lift("trial-0001")}),
            ("replay", {"movement": movement}),
        ):
            sent = probe.ask(do, known_stop=known, **goal)
            late = probe.answer(sent, arm.send)
            assert (late.code, late.stop, sent.status) == (Code.STOPPED, stopped.stop, ABORTED)
            assert not sent.stages
    go_on = probe.ask("move_to_start", lift("trial-0001"), known_stop=stopped.stop)
    assert probe.answer(go_on, arm.send).code is Code.DONE


@pytest.mark.parametrize("do", ["move_to_start", "execute", "replay", "follow"])
def test_a_cancel_stops_the_arm_and_ends_the_goal_and_a_late_one_does_nothing(
    do: str, arm: PlayedArm
) -> None:
    probe = arm.probe
    t = np.linspace(0.0, 20.0, 201)
    sway = joint_messages.JointMovement(t, HOME + 0.1 * np.sin(t)[:, None])
    movement = joint_messages.movement_message(NAMES, sway)
    goal = {"replay": {"movement": movement}, "follow": {"trajectory": movement}}.get(
        do, {"policy": lift("trial-0001")}
    )
    before = len(arm.read())
    sent = probe.ask(do, **goal)
    label = {"follow": "replay"}.get(do, do)
    label = "rollout trial-0001" if do == "execute" else label
    probe.until(
        lambda: arm.send() or label in {t.label for t in arm.read()[before:]}, "the movement"
    )
    assert probe.cancel(sent)
    probe.until(lambda: arm.send() or sent.result, "its end")
    assert sent.status == CANCELED
    if do != "follow":
        assert sent.answer.code is Code.STOPPED and sent.answer.stop
    arm.settle()
    assert arm.read()[-1].label == "hold"
    assert not probe.cancel(sent)
    again = probe.ask("move_to_start", lift("trial-0001"))
    assert probe.answer(again, arm.send).code is Code.DONE


def test_a_movement_on_the_topic_is_played_whatever_its_frame_and_a_bad_one_logged(
    arm: PlayedArm, shared_nodes: tuple[Probe, Processes]
) -> None:
    probe, processes = shared_nodes
    logged = lambda: processes.output(arm.process).count("movement refused: joints ['wam_j7']")  # noqa: E731
    before = logged()
    movements = probe.publisher(JointTrajectory, interface.REPLAY, interface.STATE_OUT)
    movements.publish(joint_messages.movement_message(NAMES[:6], STILL._replace(q=STILL.q[:, :6])))
    probe.until(lambda: logged() > before, "its log")
    assert "refused: request" in arm.diagnosis(lambda d: True, "a report")
    waypoint = joint_messages.movement_message(NAMES, STILL._replace(t=STILL.t[:1], q=STILL.q[:1]))
    still = joint_messages.movement_message(NAMES, STILL)
    for frame_id, movement in (("", still), ("world", waypoint)):
        movement.header.frame_id = frame_id
        before = len(arm.read())
        movements.publish(movement)

        def played() -> bool:
            arm.send()
            arm.answer()
            return "replay" in {torque.label for torque in arm.read()[before:]}  # noqa: B023

        probe.until(played, "the replay")
        probe.until(lambda: arm.send() or arm.answer().label == "hold", "its end")


@pytest.mark.requirement("S-18")
def test_a_parameter_that_no_real_arm_may_have_stops_the_node_and_is_named(
    processes: Processes, tmp_path: Path
) -> None:
    file = tmp_path / "incomplete.yaml"
    file.write_text("torque_controller: {ros__parameters: {autostart: true}}")
    process: Process = processes.node(MODULE, file)
    assert process.wait(60.0) == 2
    assert "autostart = True" in processes.output(process)
