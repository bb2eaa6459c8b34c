# SPDX-License-Identifier: Apache-2.0
"""Faults of the controller node over DDS: states, commanders, switch, clock, load, software."""

from __future__ import annotations

import math
import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT, Probe, Processes, diagnosis, lift
from lifecycle_msgs.msg import Transition
from played_arm import GRAVITY, HOME, NAMES, SIMULATED, PlayedArm
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from wam_power_interfaces.msg import Policy as PolicyMessage
from wam_power_ros.faults import FaultKind
from wam_power_ros.learning.policy import to_json
from wam_power_ros.ros import interface, pose_messages
from wam_power_ros.ros.outcomes import Code, Ended

DRIVER = """
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray
from wam_power_ros.ros import interface, node_runner
def make():
    node = Node("driver")
    say = lambda message: print(message.layout.dim[0].label, flush=True)
    node.create_subscription(Float64MultiArray, interface.EFFORT_COMMANDS, say, interface.COMMAND)
    return node
raise SystemExit(node_runner.run(make))
"""


def change(arm: PlayedArm, transition: int) -> bool:
    """Whether a transition of the life cycle succeeds, after a state."""
    arm.send()
    return arm.probe.change(transition)


def commander(probe: Probe) -> Publisher:
    return probe.publisher(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND)


def faulted(arm: PlayedArm) -> dict[str, str]:
    """The diagnostics of the fault that comes."""
    return arm.diagnosis(lambda d: arm.send() or d["mode"] == "fault", "a fault")


@pytest.mark.requirement("S-11")
def test_a_bad_state_is_refused_counted_named_and_never_becomes_a_torque(arm: PlayedArm) -> None:
    refused = lambda d: int(d.get("refused: joint state", "0"))  # noqa: E731
    before = refused(arm.diagnosis(lambda d: True, "a report"))
    for number, (names, q, qd, named) in enumerate(
        [
            (NAMES[:6], HOME[:6], np.zeros(6), "wam_j7"),
            (NAMES, np.append(HOME[:6], math.nan), np.zeros(7), "position"),
            (NAMES, HOME, np.full(7, math.inf), "velocity"),
        ],
        start=before + 1,
    ):
        count = len(arm.read())
        arm.send(names, q, qd)
        report = arm.diagnosis(lambda d: refused(d) == number, "the refusal")  # noqa: B023
        assert named in report["last refusal"]
        assert len(arm.read()) == count
        arm.settle()
        assert np.isfinite(arm.read()[-1].tau).all()


@pytest.mark.requirement("S-11")
def test_five_states_refused_within_fifty_are_a_fault_whatever_is_wrong_with_each(
    arm: PlayedArm,
) -> None:
    for names, q in (
        (NAMES[:6], HOME[:6]),
        ([*NAMES[:6], "wam_j1"], HOME),
        (NAMES, np.append(HOME[:6], math.nan)),
        (NAMES, np.append(HOME[:6], 1e9)),  # accepted by the reader, refused by the controller
    ):
        arm.send(names, q)
        arm.send()
        assert arm.answer().label == "hold"
    arm.send([*NAMES, "wam_j1"], np.append(HOME, 0.0))
    arm.send()
    assert arm.answer().label == "fault"
    assert faulted(arm)["fault kind"] == FaultKind.STATES_REFUSED.value


def idle_service(probe: Probe) -> list[float]:
    """The driver's service, with the times of its calls [s, steady clock]."""
    called: list[float] = []

    def idle(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        called.append(time.monotonic())
        return response

    probe.node.create_service(Trigger, interface.WAM_IDLE, idle)
    return called


@pytest.mark.requirement("S-42", "S-43")
def test_lost_states_bring_gravity_alone_then_a_fault_and_the_driver_to_idle(
    probe: Probe, processes: Processes
) -> None:
    idled = idle_service(probe)
    arm = PlayedArm(probe, processes, state_timeout=0.006)

    def held() -> bool:
        end = time.monotonic() + 0.05
        while time.monotonic() < end:
            arm.send(qd=np.full(7, 0.01))
            probe.spin(0.0015)
        label = arm.read()[-1].label if arm.read() else ""
        if label == "fault":  # a busy machine has delayed the test by 20 ms
            probe.call(Trigger, interface.RESET)
        return label == "hold"

    probe.until(held, "the arm is held")
    idled.clear()
    lost = arm.sent_ns * 1e-9  # before the last state was published
    probe.until(lambda: arm.read()[-1].label == "fault", "the fault", deadline=5.0)
    probe.until(lambda: idled, "the driver is asked to idle", deadline=5.0)
    assert idled[0] - lost > 0.08
    # By the torque that held it, which the reported motion of 0.01 rad/s has a share in.
    probe.until(
        lambda: np.allclose(arm.read()[-1].tau, GRAVITY, rtol=0.0, atol=0.2),
        "the arm is braked, and held against gravity",
    )
    report = arm.diagnosis(lambda d: d["mode"] == "fault", "the fault is reported")
    assert (report["level"], report["fault kind"]) == ("2", FaultKind.STATES_LOST.value)
    logged = lambda: processes.output(arm.process)  # noqa: E731
    probe.until(lambda: f"fault ({FaultKind.STATES_LOST.value}): " in logged(), "its log")
    assert "[ERROR]" in next(line for line in logged().splitlines() if "fault (" in line)
    resets = logged().count("the fault was reset")
    reset_logged = lambda: logged().count("the fault was reset") > resets  # noqa: E731
    probe.until(lambda: held() and reset_logged(), "a person resets, and the arm is held again")
    idled.clear()
    probe.until(lambda: idled, "the driver is asked to idle once more")


@pytest.mark.requirement("S-45")
def test_a_second_commander_is_a_fault_and_keeps_us_from_starting(arm: PlayedArm) -> None:
    probe = arm.probe
    other = commander(probe)
    report = faulted(arm)
    assert "publisher" in report["message"]
    assert report["fault kind"] == FaultKind.SECOND_COMMANDER.value
    assert change(arm, Transition.TRANSITION_DEACTIVATE)
    for _ in range(40):  # it hears them before a person lets it start
        other.publish(Float64MultiArray(data=[0.0] * 7))
        probe.spin(0.05)
    assert not change(arm, Transition.TRANSITION_ACTIVATE)
    sends = "another publisher sends commands"
    arm.diagnosis(lambda d: sends in d.get("last refusal", ""), "the refusal")
    probe.node.destroy_publisher(other)
    probe.until(lambda: change(arm, Transition.TRANSITION_ACTIVATE), "activation without it")


@pytest.mark.requirement("S-45")
def test_a_commander_that_was_silent_at_activation_is_a_fault_when_it_sends(arm: PlayedArm) -> None:
    assert change(arm, Transition.TRANSITION_DEACTIVATE)
    other = commander(arm.probe)
    arm.probe.until(lambda: change(arm, Transition.TRANSITION_ACTIVATE), "the activation")
    arm.settle()
    assert arm.read()[-1].label == "hold"

    def probed(diagnosis: dict[str, str]) -> bool:
        other.publish(Float64MultiArray(data=[0.0] * 7))  # again and again, as a commander does
        arm.send()
        arm.answer()  # unanswered states would be lost
        return diagnosis["mode"] == "fault"

    report = arm.diagnosis(probed, "a fault")
    assert report["fault kind"] == FaultKind.SECOND_COMMANDER.value
    arm.probe.node.destroy_publisher(other)

    def held() -> bool:
        arm.reset()
        arm.settle()
        return arm.read()[-1].label == "hold"

    arm.probe.until(held, "a reset suffices once the other is silent")


@pytest.mark.requirement("S-26")
def test_a_fault_outlives_the_life_cycle(arm: PlayedArm) -> None:
    other = commander(arm.probe)
    faulted(arm)
    arm.probe.node.destroy_publisher(other)
    for transition in (
        Transition.TRANSITION_DEACTIVATE,
        Transition.TRANSITION_CLEANUP,
        Transition.TRANSITION_CONFIGURE,
        Transition.TRANSITION_ACTIVATE,
    ):
        arm.probe.until(lambda: change(arm, transition), f"transition {transition}")  # noqa: B023
    arm.send()
    assert arm.answer().label == "fault"
    arm.reset()
    arm.send()
    assert arm.answer().label == "hold"


@pytest.mark.requirement("S-05")
def test_an_ended_controller_leaves_the_torque_that_carries_the_arm(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes)
    arm.activate()
    assert processes.end(arm.process, signal.SIGTERM) == 0
    probe.spin(0.3)
    last = arm.read()[-1]
    assert last.label == "inactive"
    np.testing.assert_allclose(last.tau, GRAVITY, atol=1e-9)
    assert "Traceback" not in processes.output(arm.process)


@pytest.mark.requirement("S-05")
def test_an_ended_controller_waits_until_a_busy_driver_has_the_last_torque(
    probe: Probe, processes: Processes
) -> None:
    driver = processes.script(DRIVER)
    arm = PlayedArm(probe, processes)
    arm.activate()

    def heard(label: str) -> bool:
        arm.send()
        return label in processes.output(driver).split()

    probe.until(lambda: heard("hold"), "a driver that receives torques")
    driver.send_signal(signal.SIGSTOP)
    arm.process.send_signal(signal.SIGINT)
    time.sleep(1.3)  # it needs 0.6 s to bring the arm to rest
    assert arm.process.poll() is None
    driver.send_signal(signal.SIGCONT)
    probe.until(lambda: heard("inactive"), "the last torque at the driver")
    probe.until(lambda: arm.process.poll() == 0, "the controller's end")


@pytest.mark.requirement("S-30")
def test_a_released_or_silent_switch_ends_teaching(probe: Probe, processes: Processes) -> None:
    arm = PlayedArm(probe, processes, hold_to_run=True)
    arm.activate()
    switch = probe.publisher(Bool, interface.ENABLE, interface.COMMAND)
    on = SetBool.Request(data=True)
    refusal = probe.call(SetBool, interface.GRAVITY_COMPENSATION, on)
    assert not refusal.success and "enabling switch" in refusal.message

    def teaching() -> bool:
        switch.publish(Bool(data=True))
        probe.spin(0.005)
        arm.send()
        arm.answer()
        return probe.call(SetBool, interface.GRAVITY_COMPENSATION, on).success

    def ended() -> bool:
        arm.send()
        return arm.answer().label == "fault"

    for silent in (False, True):
        probe.until(teaching, "teaching begins")
        arm.diagnostics.clear()
        switch.publish(Bool(data=True))
        probe.spin(0.2 if silent else 0.005)
        if not silent:
            switch.publish(Bool(data=False))
        probe.until(ended, "the fault")
        arm.diagnosis(lambda d: "enabling switch" in d["message"], "the report")
        arm.reset()


@pytest.mark.requirement("S-52")
def test_a_controller_that_was_stopped_faults_and_does_not_have_the_driver_idled(
    probe: Probe, processes: Processes
) -> None:
    idled = idle_service(probe)
    arm = PlayedArm(probe, processes, state_timeout=0.05)

    pauses: list[float] = []

    def flow(seconds: float) -> None:
        end = time.monotonic() + seconds
        while (begin := time.monotonic()) < end:
            arm.send()
            probe.spin(0.0015)
            pauses.append(time.monotonic() - begin)

    def held() -> bool:
        flow(0.05)
        label = arm.read()[-1].label if arm.read() else ""
        if label == "fault":  # a busy machine has delayed the test
            probe.call(Trigger, interface.RESET)
        return label == "hold"

    probe.until(held, "the arm is held")
    idled.clear()
    pauses.clear()
    arm.process.send_signal(signal.SIGSTOP)
    flow(0.5)
    arm.process.send_signal(signal.SIGCONT)

    def faulted() -> bool:
        flow(0.02)
        return arm.read()[-1].label == "fault"

    probe.until(faulted, "the fault")
    assert not idled or max(pauses) > 0.05  # a busy machine has delayed the test


BROKEN = """
import sys
from wam_power_ros.nodes import torque_controller

class Broken(torque_controller.TorqueController):
    def __init__(self):
        super().__init__()
        self._requests.begin = lambda *request: {}["a mistake in the code"]

    def _on_stop(self, request, response):
        self._read = None  # every state from now on

torque_controller.TorqueController = Broken
sys.exit(torque_controller.main())
"""


@pytest.mark.requirement("S-49")
def test_without_real_time_rights_an_arm_is_not_activated_unless_allowed(
    probe: Probe, processes: Processes
) -> None:
    arm = PlayedArm(probe, processes, realtime_priority=0, allow_no_realtime=False)

    def refused() -> bool:
        arm.send()
        probe.spin(0.02)
        return "SCHED_FIFO" in diagnosis(arm.diagnostics, "torque_controller").get(
            "last refusal", ""
        )

    probe.until(refused, "the refusal is reported")
    assert not arm.read()


@pytest.mark.requirement("S-50")
@pytest.mark.parametrize("allowed", [True, False])
def test_an_overload_is_a_warning_and_a_larger_one_a_fault(
    probe: Probe, processes: Processes, allowed: bool
) -> None:
    arm = PlayedArm(
        probe,
        processes,
        realtime_priority=60,
        state_timeout=10.0,  # on a slow machine states are late, not lost
        allow_no_realtime=allowed,
        idle_service='""',
    )
    status = lambda: diagnosis(arm.diagnostics, "torque_controller")  # noqa: E731

    def begun() -> bool:
        arm.send()
        probe.spin(0.002)
        return bool(arm.read())

    if not allowed and os.geteuid():
        pytest.skip("real-time scheduling is not permitted here")
    probe.until(begun, "the controller is active")

    def late() -> bool:  # every state 6 to 10 ms after the last: two of three periods are missed
        arm.send()
        probe.spin(0.006)
        text = status().get("message", "")
        if status().get("mode") == "fault" and "periods" not in text:  # a delay of a busy machine
            probe.call(Trigger, interface.RESET)
        return "of the periods of a second missed" in text

    probe.until(late, "the overload is reported")
    assert status()["mode"] == ("hold" if allowed else "fault")


@pytest.mark.requirement("S-51")
def test_a_clock_that_jumps_is_a_fault_in_which_torques_go_on(arm: PlayedArm) -> None:
    for hours in (1, -1):
        arm.send()
        before = arm.answer()
        arm.stamp_ns += hours * 3_600_000_000_000
        for _ in range(8):  # five are refused first when they are older
            arm.send()
            arm.probe.spin(0.02)
        arm.send()
        after = arm.answer()
        assert after.label == "fault"
        np.testing.assert_allclose(after.tau, before.tau, atol=1e-3)
        arm.reset()
        arm.settle()
        assert arm.read()[-1].label == "hold"


@pytest.mark.requirement("S-02")
def test_a_callback_that_fails_is_a_fault_and_not_the_end_of_the_node(
    probe: Probe, processes: Processes
) -> None:
    config = ["--ros-args"]
    for file in SIMULATED:
        config += ["--params-file", str(ROOT / "config" / file)]
    quick = ["-p", "realtime_priority:=0", "-p", "state_timeout:=0.0"]
    arm = PlayedArm(probe, processes, processes.script(BROKEN, *config, *quick))
    arm.activate()

    def failure() -> dict[str, str]:
        arm.send()
        probe.spin(0.01)
        report = diagnosis(arm.diagnostics, "torque_controller")
        return report if report.get("mode") == "fault" else {}

    for act in (
        lambda: probe.ask("execute", lift("good")),
        lambda: arm.reset() or arm.diagnostics.clear() or probe.begin(Trigger, interface.STOP),
    ):
        act()
        assert "a callback failed" in probe.until(failure, "the fault is reported")["message"]
        probe.until(lambda: arm.read()[-1].label == "fault", "the arm is carried")
        np.testing.assert_allclose(arm.read()[-1].tau, GRAVITY, atol=1e-9)
        assert arm.process.poll() is None


@pytest.mark.requirement("S-101")
def test_a_controller_in_simulation_falls_silent_when_a_driver_appears(arm: PlayedArm) -> None:
    probe, begun = arm.probe, len(arm.read()) - 1
    states = probe.publisher(
        JointState, interface.JOINT_STATES, interface.STATE_OUT, node="joint_state_broadcaster"
    )
    report = arm.diagnosis(lambda d: arm.send() or d["mode"] == "inactive", "its end")
    assert "node 'joint_state_broadcaster' publishes /joint_states" in report["last refusal"]
    probe.spin(0.2)
    labels, count = {torque.label for torque in arm.read()[begun:]}, len(arm.read())
    assert labels == {"hold"}  # not even a last torque
    for _ in range(100):
        arm.send()
        probe.spin(0.005)
    assert len(arm.read()) == count
    assert not change(arm, Transition.TRANSITION_ACTIVATE)
    states.destroy()
    probe.until(lambda: change(arm, Transition.TRANSITION_ACTIVATE), "activation without it")
    arm.send()
    assert arm.answer().label == "hold"


@pytest.mark.requirement("S-104")
def test_no_service_says_done_in_a_fault_but_a_stop_that_names_it(arm: PlayedArm) -> None:
    probe = arm.probe
    other = commander(probe)
    faulted(arm)
    probe.node.destroy_publisher(other)

    def ask(kind: type, name: str, request: object = None) -> tuple[bool, str]:
        arm.send()
        response = probe.call(kind, name, request)
        return response.success, response.message

    for on in (True, False):
        request = SetBool.Request(data=on)
        done, text = ask(SetBool, interface.GRAVITY_COMPENSATION, request)
        assert not done and "fault (" in text
    execute = probe.ask("execute", lift("trial-0001"))
    assert probe.answer(execute, arm.send).code is Code.FAULT
    done, text = ask(Trigger, interface.STOP)
    assert done and "nothing to stop: fault (" in text


@pytest.mark.requirement("S-103")
def test_each_request_executes_the_policy_that_it_brings_whatever_its_id(arm: PlayedArm) -> None:
    probe = arm.probe
    ours, theirs = lift("trial-0001"), replace(lift("trial-0001"), damping=31.0)
    accepted = probe.listen(PolicyMessage, interface.POLICY, interface.LATCHED)
    for policy in (ours, theirs):
        move = probe.ask("move_to_start", policy)
        assert probe.answer(move, arm.send).success
        execute = probe.ask("execute", policy)
        probe.until(lambda: arm.send() or execute.begun, "the rollout")  # noqa: B023
        assert execute.answer is None
        probe.until(lambda: accepted and accepted[-1].text == to_json(policy), "what is executed")  # noqa: B023
        assert accepted[-1].id == "trial-0001"
        for _ in range(20):
            arm.send()
            arm.answer()
        probe.call(Trigger, interface.STOP)
        answer = probe.answer(execute, arm.send)
        end = Ended.read(execute.result.end)
        assert (answer.code, end.policy_id, end.fault) == (Code.STOPPED, "trial-0001", None)
        assert answer.stop == end.stop != ""
        path = pose_messages.path(execute.result.path)
        assert path.start_ns == end.start_ns and len(path.t) > 1
        arm.settle()


@pytest.mark.requirement("S-125")
def test_an_unexplained_torque_is_said_in_the_diagnostics(arm: PlayedArm) -> None:
    probe = arm.probe
    sagged = HOME - 0.004 * np.eye(7)[1]  # the hold pushes against it

    def said() -> bool:
        for _ in range(50):
            arm.send(q=sagged)
            arm.answer()
        found = diagnosis(arm.diagnostics, "torque_controller")
        return "wam_j2: " in found.get("message", "")

    probe.until(said, "the unexplained torque")
    report = diagnosis(arm.diagnostics, "torque_controller")
    assert report["level"] == "1" and "N m unexplained" in report["message"]
    assert "wam_j2: " in report["unexplained torque"]
    assert arm.read()[-1].label == "hold"
    answer = probe.call(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=True))
    assert not answer.success and "wam_j2: " in answer.message
