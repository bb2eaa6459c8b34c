# SPDX-License-Identifier: Apache-2.0
"""The driver of a Franka robot, by its maker's library, against a robot's server on the loopback.

Needs `pip install pylibfranka` and `pip install --no-deps franka-sim`, which asks for an old NumPy.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from conftest import ROOT, Probe, Processes, diagnosis
from lifecycle_msgs.msg import Transition
from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.params import overlay
from wam_power_ros.ros import interface, joint_messages, node_runner
from wam_power_ros.ros.stamps import nanoseconds

franka = pytest.importorskip("pylibfranka")
pytest.importorskip("franka_sim")
pytestmark = pytest.mark.alone

ADDRESS = "127.0.57.1"
LAB = """
torque_controller: {ros__parameters: {hold_to_run: false}}
franka_driver: {ros__parameters: {address: 127.0.57.1}}
"""
DRIVER, CONTROLLER = "wam_power_ros.nodes.franka_driver", "wam_power_ros.nodes.torque_controller"
IDLE, MOVE = 1, 2  # modes of the robot
JOINT_REFLEX, COMMUNICATION = 6, 25  # errors, by their number in the protocol


class Server:
    """A robot's server in a process of its own."""

    def __init__(self, log: Path) -> None:
        with log.open("a") as output:
            self.process = subprocess.Popen(
                [sys.executable, str(ROOT / "test/franka_server.py"), ADDRESS],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=output,
                text=True,
            )

    def ask(self, line: str = "arm") -> dict[str, Any]:
        """Answer to a line: posture, speeds, mode; empty before the server is ready."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline()) or {}

    def end(self) -> None:
        """End it at once, as the loss of power does."""
        self.process.kill()
        self.process.wait()


class Seconds(float):
    """A time of the library."""

    to_sec = float.__float__


class Ignored:
    """A publisher of what nobody reads."""

    def publish(self, message: object) -> None: ...  # noqa: D102


class Bench:
    """Robot, driver and controller, with what each says."""

    def __init__(self, probe: Probe, processes: Processes, folder: Path) -> None:
        (folder / "lab.yaml").write_text(LAB)
        setup = overlay.setup(["franka_fci", str(folder / "lab.yaml")])
        self.file, self.log = folder / "parameters.yaml", folder / "server.log"
        self.file.write_text(overlay.text(setup))
        self.names = setup.joint_names
        self.probe, self.processes, self.server = probe, processes, Server(self.log)
        self.diagnostics = probe.diagnostics()
        self.states = probe.listen(JointState, "franka/joint_states", interface.STATE_RECORD)
        self.sent = probe.listen(Float64MultiArray, interface.EFFORT_COMMANDS, interface.DEEP_IN)
        probe.until(self.server.ask, "the robot")
        self.driver = processes.node(DRIVER, self.file)
        self.controller = processes.node(CONTROLLER, self.file)
        probe.until(lambda: len(self.states) > 200, "states")
        for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            probe.until(lambda: probe.change(transition), "the controller active")  # noqa: B023
        self.taken()

    def say(self, node: str, key: str) -> str:
        """The newest value of a status."""
        return diagnosis(self.diagnostics, node).get(key, "")

    def until(self, node: str, key: str, accept: Callable[[str], bool]) -> str:
        """Wait for a value of a status that is sent from now on."""
        self.diagnostics.clear()
        self.probe.until(lambda: accept(self.say(node, key)), f"{key} of {node}")
        return self.say(node, key)

    def taken(self) -> None:
        """Wait until the robot takes torques of a controller that holds."""
        self.until("franka_driver", "torques", lambda text: text == "passed on")
        self.until("torque_controller: loop", "mode", lambda mode: mode == "hold")

    def reset(self) -> None:
        """Reset the controller, once the arm has been at rest, and wait until it is held."""
        self.probe.spin(1.5)  # the second with the gap counts as missed periods
        trigger = lambda: self.probe.call(Trigger, interface.RESET).success  # noqa: E731
        self.probe.until(lambda: self.probe.spin(0.2) or trigger(), "a reset")
        self.taken()

    def replay(self) -> Any:  # noqa: ANN401 (conftest's)
        """Begin a replay of 0.3 rad in 2 s, from where the arm is."""
        t = np.linspace(0.0, 2.0, 101)
        shape = np.sin(np.pi * t / 2.0) ** 2
        q = np.array(self.server.ask()["q"]) + np.outer(shape, [0, 0.3, 0, 0.3, 0, -0.3, 0])
        movement = joint_messages.JointMovement(t, q)
        sent = self.probe.replay(joint_messages.movement_message(self.names, movement))
        self.probe.until(lambda: np.abs(self.server.ask()["dq"]).max() > 0.2, "a motion")
        return sent

    def rests(self) -> float:
        """Wait until the arm rests; the way it went [rad]."""
        begin = np.array(self.server.ask()["q"])
        self.probe.until(lambda: np.abs(self.server.ask()["dq"]).max() < 0.01, "rest", 10.0)
        return float(np.abs(np.array(self.server.ask()["q"]) - begin).max())


@pytest.fixture
def bench(probe: Probe, processes: Processes, tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(probe, processes, tmp_path)
    yield bench
    processes.close()
    bench.server.end()


def test_the_robot_is_held_and_follows_a_replay_at_1_khz(bench: Bench) -> None:
    before = np.array(bench.server.ask()["q"])
    answer = bench.probe.answer(bench.replay())
    assert answer.success, answer
    assert np.abs(np.array(bench.server.ask()["q"]) - before).max() < 0.01
    stamps = np.array([nanoseconds(each.header.stamp) for each in bench.states])
    assert (np.diff(stamps) > 0).all()
    assert np.median(np.diff(stamps)) == pytest.approx(2e6, abs=0.1e6)
    assert {tuple(each.name) for each in bench.states} == {tuple(bench.names)}
    assert float(bench.until("franka_driver", "success rate", bool)) > 0.9
    assert bench.server.ask()["mode"] == MOVE


def test_a_hand_guides_the_arm_which_then_stays_where_it_was_left(
    bench: Bench, tmp_path: Path
) -> None:
    free = bench.probe.call(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=True))
    assert free.success, free
    t, begin = np.linspace(0.0, 2.0, 101), np.array(bench.server.ask()["q"])
    way = np.outer(np.sin(np.pi * t / 4.0) ** 2, [0.3, 0.2, 0.0, -0.3, 0.0, 0.3, 0.0])
    np.save(tmp_path / "shown.npy", np.column_stack([t, begin + way]))
    bench.server.ask(f"lead {tmp_path / 'shown.npy'}")
    bench.probe.spin(2.5)
    left = np.array(bench.server.ask()["q"])
    assert np.abs(left - begin - way[-1]).max() < 0.03
    assert bench.probe.call(
        SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=False)
    ).success
    bench.taken()
    assert np.abs(np.array(bench.server.ask()["q"]) - left).max() < 0.01


@pytest.mark.parametrize(
    ("number", "name"),
    [(JOINT_REFLEX, "joint_reflex"), (COMMUNICATION, "communication_constraints_violation")],
)
def test_a_reflex_is_named_and_recovered_from_by_a_reset_and_by_nothing_else(
    bench: Bench, number: int, name: str
) -> None:
    sent = bench.replay()
    bench.server.ask(f"reflex {number}")
    assert not bench.probe.answer(sent).success
    assert bench.until("franka_driver", "fault", bool).startswith(f"{name}: ")
    assert bench.until("torque_controller: loop", "fault kind", bool) == "states_lost"
    bench.rests()
    bench.probe.spin(1.0)  # the controller sends torques all the time
    assert bench.server.ask()["mode"] == IDLE
    assert bench.say("franka_driver", "torques") == "not passed on"
    bench.reset()
    assert bench.say("franka_driver", "fault") == ""
    assert bench.probe.answer(bench.replay()).success


def test_a_driver_that_pauses_is_stopped_by_the_robot_and_goes_on_after_a_reset(
    bench: Bench,
) -> None:
    bench.replay()
    bench.driver.send_signal(signal.SIGSTOP)
    bench.rests()
    bench.driver.send_signal(signal.SIGCONT)
    fault = bench.until("franka_driver", "fault", bool)
    assert fault.startswith("communication_constraints_violation: 20 torques in a row came late")
    bench.reset()


def test_the_persons_switch_ends_a_movement_and_its_release_moves_nothing(bench: Bench) -> None:
    sent = bench.replay()
    bench.server.ask("stopped")
    assert not bench.probe.answer(sent).success
    assert bench.until("franka_driver", "fault", bool).startswith("UserStopped: ")
    bench.probe.spin(1.0)
    bench.server.ask("released")
    bench.probe.spin(1.0)
    assert bench.server.ask()["mode"] == IDLE
    bench.reset()


@pytest.mark.parametrize("who", ["controller", "driver"])
def test_a_process_that_is_killed_leaves_an_arm_that_the_robot_holds(
    bench: Bench,
    who: str,
    record_property: Any,  # noqa: ANN401
) -> None:
    bench.replay()
    (bench.controller if who == "controller" else bench.driver).kill()
    record_property("way [rad]", way := bench.rests())
    assert way < 0.3
    bench.probe.until(lambda: bench.server.ask()["mode"] == IDLE, "the robot's own hold", 5.0)
    posture = np.array(bench.server.ask()["q"])
    bench.probe.spin(1.0)
    assert np.abs(np.array(bench.server.ask()["q"]) - posture).max() < 0.005
    if who == "driver":
        bench.driver = bench.processes.node(DRIVER, bench.file)
        bench.reset()


def test_a_torque_that_is_not_renewed_moves_nothing(bench: Bench) -> None:
    bench.controller.kill()
    bench.probe.until(lambda: bench.server.ask()["mode"] == IDLE, "the robot's own hold", 5.0)
    before = np.array(bench.server.ask()["q"])
    topic = interface.EFFORT_COMMANDS
    torques = bench.probe.publisher(Float64MultiArray, topic, interface.COMMAND)
    for data in ([0.0, 8.0, 0.0, 0.0, 0.0, 0.0, 0.0], [np.nan] * 7, [50.0] * 6):
        torques.publish(Float64MultiArray(data=data))
        bench.probe.spin(0.2)  # the driver keeps the newest alone
    bench.until("franka_driver", "torques refused", lambda text: text == "2")
    bench.probe.until(lambda: bench.server.ask()["mode"] == IDLE, "the robot's own hold", 5.0)
    assert np.abs(np.array(bench.server.ask()["q"]) - before).max() < 0.02


def test_states_that_are_frozen_in_a_movement_end_it(
    bench: Bench,
    record_property: Any,  # noqa: ANN401
) -> None:
    sent = bench.replay()
    bench.server.ask("freeze 3.0")
    begin = np.array(bench.server.ask()["q"])
    assert not bench.probe.answer(sent).success
    kind = bench.until("torque_controller: loop", "fault kind", bool)
    assert kind in ("velocity", "external_torque", "tracking", "standstill", "drift", "jump")
    record_property("kind", kind)
    bench.rests()
    record_property("way [rad]", np.abs(np.array(bench.server.ask()["q"]) - begin).max())
    bench.probe.spin(3.0)
    bench.reset()


def test_a_robot_that_is_gone_is_named_and_connected_to_again(bench: Bench) -> None:
    bench.server.end()
    assert ADDRESS in bench.until("franka_driver", "fault", bool)
    bench.server = Server(bench.log)
    bench.probe.until(bench.server.ask, "the robot")
    bench.reset()


def test_the_arm_is_handed_to_the_robot_when_the_driver_ends(bench: Bench) -> None:
    bench.replay()
    assert bench.processes.end(bench.driver) == 0
    bench.rests()
    assert bench.server.ask()["mode"] == IDLE


def test_each_error_of_the_library_is_known_and_none_is_one_of_ros() -> None:
    from wam_power_ros.nodes.franka_driver import ERRORS

    raised = {each for each in vars(franka).values() if isinstance(each, type)}
    raised = {each for each in raised if issubclass(each, Exception)}
    assert raised == {franka.ControlException, *ERRORS}
    assert not issubclass(rclpy_implementation.RCLError, tuple(raised))


def test_an_error_of_ros_ends_the_driver_and_is_not_blamed_on_the_robot(
    domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from wam_power_ros.nodes.franka_driver import FrankaDriver

    class Mute(FrankaDriver):
        def _publish(self, state: Any) -> None:  # noqa: ANN401
            self.destroy_publisher(self._states)
            super()._publish(state)

    (file := tmp_path / "lab.yaml").write_text(LAB.replace("}}", ", realtime_priority: 0}}"))
    monkeypatch.setattr(sys, "argv", ["", "--ros-args", "--params-file", str(file)])
    server = Server(tmp_path / "server.log")
    try:
        with node_runner.participant(Mute, domain_id) as driver:
            end = time.monotonic() + 60.0
            with pytest.raises(InvalidHandle):
                driver.serve(lambda: time.monotonic() > end)
            assert "destroyable" not in driver.fault.lower()
    finally:
        server.end()


def test_a_state_that_waited_is_stamped_when_it_was_measured_and_a_new_clock_is_followed(
    domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from wam_power_ros.nodes.franka_driver import LATE_STATES, FrankaDriver

    class Measured(NamedTuple):
        time: Any
        q: tuple[float, ...] = (0.0,) * 7
        dq: tuple[float, ...] = (0.0,) * 7
        tau_J: tuple[float, ...] = (0.0,) * 7

    (file := tmp_path / "lab.yaml").write_text(LAB.replace("}}", ", realtime_priority: 0}}"))
    monkeypatch.setattr(sys, "argv", ["", "--ros-args", "--params-file", str(file)])
    monkeypatch.setattr(time, "time_ns", lambda: now_ns)
    with node_runner.participant(FrankaDriver, domain_id) as driver:
        monkeypatch.setattr(driver, "_write", lambda stamp_ns, *_: stamps.append(stamp_ns))
        monkeypatch.setattr(driver, "_states", Ignored())
        stamps, errors = [], []
        for k in range(900):
            waited_ns = 14_000_000 if k == 200 else 500_000
            ahead_ns = 60_000_000_000 if k >= 400 else 0  # the system's clock was set
            now_ns = 10**18 + 2_000_000 * k + waited_ns + ahead_ns
            driver._publish(Measured(Seconds(100.0 + 0.002 * k)))
            errors.append(stamps[-1] - (now_ns - waited_ns))
    assert np.abs(errors[:400]).max() < 1_000_000
    assert np.abs(errors[400 + LATE_STATES + 1 :]).max() < 1_000_000
    assert min(np.diff(stamps)) > 1_000_000


def test_a_driver_without_an_address_says_what_is_missing(processes: Processes) -> None:
    driver = processes.node(DRIVER, "franka_driver.yaml")
    assert driver.wait(60.0) == 2
    assert "address of franka_driver is empty" in processes.output(driver)
