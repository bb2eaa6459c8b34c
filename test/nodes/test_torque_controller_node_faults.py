# SPDX-License-Identifier: Apache-2.0
"""Faults of the controller node over DDS: states, commanders, switch, clock, load, software."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from conftest import Probe, Processes, diagnosis, lift
from lifecycle_msgs.msg import Transition
from played_arm import GRAVITY, HOME, NAMES, TICK, ControllerHere, PlayedArm
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from wam_power_interfaces.msg import Policy as PolicyMessage
from wam_power_ros.faults import FaultKind
from wam_power_ros.learning.policy import to_json
from wam_power_ros.nodes import torque_controller
from wam_power_ros.nodes.torque_controller import ENABLE_TIMEOUT_NS
from wam_power_ros.ros import interface, joint_messages, node_runner, pose_messages
from wam_power_ros.ros.outcomes import Code, Ended
from wam_power_ros.ros.scheduling import Granted

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
def test_five_states_refused_within_fifty_are_a_fault_whatever_is_wrong_with_each(
    arm: PlayedArm,
) -> None:
    for names, q in (
        (NAMES[:6], HOME[:6]),
        ([*NAMES[:6], "wam_j1"], HOME),
        (NAMES, np.append(HOME[:6], math.nan)),
        (NAMES, np.append(HOME[:6], 1e9)),  # accepted by the reader, refused by the controller
    ):
        count = len(arm.read())
        arm.send(names, q)
        arm.send()
        assert arm.answer().label == "hold"
        assert len(arm.read()) == count + 1  # the refused one has no torque
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
    assert f"fault ({FaultKind.STATES_LOST.value}): " in processes.output(arm.process)
    probe.until(held, "a person resets, and the arm is held again")
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
def test_a_commander_that_was_silent_at_activation_is_a_fault_when_it_sends(
    arm: PlayedArm,
) -> None:
    assert change(arm, Transition.TRANSITION_DEACTIVATE)
    other = commander(arm.probe)
    arm.probe.until(lambda: change(arm, Transition.TRANSITION_ACTIVATE), "the activation")
    arm.settle()
    assert arm.read()[-1].label == "hold"
    other.publish(Float64MultiArray(data=[0.0] * 7))
    assert faulted(arm)["fault kind"] == FaultKind.SECOND_COMMANDER.value
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
def test_an_ended_controller_waits_until_a_busy_driver_has_the_torque_that_carries_the_arm(
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
    assert arm.read()[-1].label == "inactive"
    np.testing.assert_allclose(arm.read()[-1].tau, GRAVITY, atol=1e-9)
    assert "Traceback" not in processes.output(arm.process)


@pytest.mark.requirement("S-30")
def test_a_released_or_silent_switch_ends_teaching(
    controller_here: Callable[..., ControllerHere],
) -> None:
    arm = controller_here(hold_to_run=True)
    node = arm.node
    assert arm.configure()
    arm.send()
    assert arm.activate()
    on = SetBool.Request(data=True)
    for silent in (False, True):
        for _ in range(400):  # until the torque that holds the arm is known
            assert arm.send() == "hold"
        refusal = node._on_gravity_compensation(on, SetBool.Response())
        assert not refusal.success and "enabling switch" in refusal.message
        node._on_enable(Bool(data=True))
        arm.send()
        assert node._on_gravity_compensation(on, SetBool.Response()).success
        assert arm.send() == "gravity_compensation"
        if silent:
            time.sleep(ENABLE_TIMEOUT_NS * 1e-9)
        else:
            node._on_enable(Bool(data=False))
        assert arm.send() == "fault"
        assert "enabling switch" in node._controller.latched.text
        for _ in range(400):
            arm.send()
        node._reset(node._controller, Trigger.Request())


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


@pytest.mark.requirement("S-49")
def test_without_real_time_rights_an_arm_is_not_activated_unless_allowed(
    controller_here: Callable[..., ControllerHere],
) -> None:
    arm = controller_here(allow_no_realtime=False)
    assert arm.configure()
    for granted in (Granted("refused", "granted"), Granted("granted", "refused")):
        arm.node._granted = granted
        arm.send()
        assert not arm.activate()
        said = "activation refused: no real-time scheduling (SCHED_FIFO"
        assert arm.refused.pop().startswith(said)
    arm.node._granted = Granted("granted", "granted")
    assert arm.activate()


@pytest.mark.requirement("S-50")
@pytest.mark.parametrize("allowed", [True, False])
def test_an_overload_is_a_warning_and_a_larger_one_a_fault(
    controller_here: Callable[..., ControllerHere], allowed: bool
) -> None:
    arm = controller_here(allow_no_realtime=allowed, state_timeout=10.0)
    assert arm.configure()
    arm.node._granted = Granted("granted", "granted")
    arm.send()
    assert arm.activate()
    now_ns, statistics = time.monotonic_ns(), arm.node._statistics
    statistics.report()
    for periods, warned in ((1, False), (3, True)):  # from each state to the next
        for _ in range(200):
            now_ns += periods * TICK
            statistics.add(now_ns, now_ns)
        arm.node._publish_report()
        assert ("of the periods of a second missed" in arm.node._figures()[1]) == warned
    assert (arm.node._controller.latched is None) == allowed


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
    controller_here: Callable[..., ControllerHere], monkeypatch: pytest.MonkeyPatch
) -> None:
    spun: list[Callable[..., None]] = []  # as the process of the node spins it
    monkeypatch.setattr(node_runner, "run", lambda _, spin: spun.append(spin))
    torque_controller.main()
    arm = controller_here()
    node = arm.node
    assert arm.configure()
    arm.send()
    assert arm.activate()

    def mistake(*_: object) -> None:
        raise KeyError("a mistake in the code")

    def spin() -> None:
        end = time.monotonic() + 60.0
        spun[0](node, lambda: arm.label == "fault" or time.monotonic() > end)

    def fail_in_a_callback() -> None:
        timer = node.create_timer(0.01, mistake)
        spin()
        node.destroy_timer(timer)

    def fail_between_callbacks() -> None:
        poll, node._preparation.poll = node._preparation.poll, mistake
        spin()
        node._preparation.poll = poll

    def fail_in_a_state() -> None:
        read, node._read = node._read, mistake
        arm.send()
        node._read = read

    for fail in (fail_in_a_callback, fail_between_callbacks, fail_in_a_state):
        for _ in range(400):
            assert arm.send() == "hold"
        fail()
        assert arm.label == "fault"
        np.testing.assert_allclose(joint_messages.torque(arm.sent[-1], NAMES).tau, GRAVITY)
        assert "a callback failed: KeyError" in node._controller.latched.text
        for _ in range(400):
            arm.send()
        node._reset(node._controller, Trigger.Request())


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
        end = Ended.of(execute.result.end)
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
