# SPDX-License-Identifier: Apache-2.0
"""No plain parameter files move a robot; some are started beside a stranger's driver.

Plain: given by `--params-file`, as `ros2 run` does, without the set-ups' overlay.
"""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest
import yaml
from conftest import ROOT, Probe, Processes, diagnosis
from rcl_interfaces.srv import GetParameters

from wam_power_ros.params import overlay
from wam_power_ros.params.torque_controller_params import TorqueControllerParams

MODULES = {  # other nodes have no topic for a torque (test_security)
    "torque_controller": "wam_power_ros.nodes.torque_controller",
    "wam_sim": "hardware_sim.main",
}
RECORDER = "wam_power_ros.nodes.demonstration_recorder"
FILES = sorted(path.stem for path in (ROOT / "config").glob("*.yaml"))
SETUPS = [name for name in FILES if name not in overlay.NODES]
DRIVERS = ("geodude", "libbarrett", "ur")  # of arms; franka and openarm have the shape of ur
ARMS = (
    "cobot",
    "full_speed",
    "kilohertz",
    "position",
    "reach",
    "simulation",
    "trajectory",
)  # other files with parameters of an arm
OBSERVED = 1.0  # [s] after a node has reported: an active controller sends 100 torques in it
JOINTS = [
    f"{stem}{number}"
    for stem in ("wam_j", "right_j", "q", "fr3_joint", "cobot_joint", "openarm_joint")
    for number in range(1, 8)
]
JOINTS += overlay.setup(["ur"]).joint_names
# Real time, 100 states a second with the joints of every set-up; says that a torque has come.
DRIVER = f"""
import sys, time
import rclpy
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from wam_power_ros.ros import interface, joint_messages
rclpy.init()
node = Node("controller_manager")
def hear(message):
    print("torque", flush=True)
states = []
for place in sys.argv[1:]:
    for topic in ("joint_states", "franka/joint_states", "wam/jointVelocity"):
        name = f"{{place}}/{{topic}}"
        states.append(node.create_publisher(JointState, name, interface.STATE_OUT))
    qos = interface.COMMAND
    for forwarder in ("effort_controller", "forward_effort_controller"):
        topic = f"{{place}}/{{forwarder}}/commands"
        node.create_subscription(Float64MultiArray, topic, hear, qos)
    node.create_subscription(JointState, f"{{place}}/joint_torque_commands", hear, qos)
names = {JOINTS!r}
count_of_joints = len(names)
home = ([0.0, 0.35, 0.0, 2.0, 0.0, -0.47, 0.0] * 7)[:count_of_joints]
still = [0.0] * count_of_joints
def send():
    message = JointState(name=names, position=home, velocity=still, effort=still)
    message.header.stamp = node.get_clock().now().to_msg()
    serialized = serialize_message(message)  # once for all of them
    for publisher in states:
        publisher.publish(serialized)
node.create_timer(0.01, send)
print("driver", flush=True)
rclpy.spin(node)
"""


def combinations(node: str) -> Iterator[tuple[str, ...]]:
    """Lists of parameter files that a person may give to a node, the most telling ones first."""
    own = ("wam_sim", "optitrack_sim") if node == "wam_sim" else (node,)
    yield own
    yield (*own, "simulation")
    for driver in DRIVERS:  # the simulation's file before the driver's
        yield (*own, "simulation", driver)
    for name in SETUPS:
        yield (*own, name)
    for driver, other in product(DRIVERS, [name for name in ARMS if name in SETUPS]):
        yield (*own, driver, other)


def files(names: tuple[str, ...]) -> list[Path]:
    return [ROOT / f"config/{name}.yaml" for name in names]


@pytest.mark.requirement("S-101")
def test_whatever_files_are_combined_a_controller_starts_itself_in_simulation_alone() -> None:
    found = {True: 0, False: 0}
    for names in combinations("torque_controller"):
        try:
            params = TorqueControllerParams.from_setup(overlay.from_files(files(names)))
        except ValueError:  # refused: it sends nothing
            continue
        assert not params.autostart or params.simulation, names
        found[params.simulation] += 1
    assert min(found.values()) > len(DRIVERS)


@pytest.mark.requirement("S-101")
@pytest.mark.parametrize("node", MODULES)
def test_plain_files_and_printed_ones_send_no_torque_to_a_strangers_driver(
    node: str, probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    own = next(combinations(node))
    printed = tmp_path / "ur.yaml"  # as `wam-power config` prints it
    printed.write_text(overlay.text(overlay.setup(["ur"], True)))
    lists = [files(own), files((*own, "simulation", "geodude")), [printed]]
    places = [f"/place{number}" for number in range(len(lists))]
    reports = probe.diagnostics()
    driver = processes.script(DRIVER, *places)
    probe.until(lambda: "driver" in processes.output(driver), "the driver")
    started = {}
    for place, paths in zip(places, lists, strict=True):
        command = [sys.executable, "-m", MODULES[node], "--ros-args", "-r", f"__ns:={place}"]
        given = [word for path in paths for word in ("--params-file", str(path))]
        started[place] = processes.start([*command, *given])
    for place, process in started.items():  # it has reported, or refused to run
        up = lambda: process.poll() == 2 or diagnosis(reports, f"{place[1:]}/{node}")  # noqa: B023, E731
        probe.until(up, f"{node} at {place}")
    probe.spin(OBSERVED)
    assert "torque" not in processes.output(driver)


@pytest.mark.requirement("S-101")
def test_on_an_arm_the_controller_is_activated_once_a_person_has_agreed_and_not_before(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    driver = processes.script(DRIVER, "")
    probe.until(lambda: "driver" in processes.output(driver), "the driver")
    rights = {"allow_no_realtime": True, "realtime_priority": 0}  # of a machine for tests
    file = tmp_path / "machine.yaml"
    file.write_text(yaml.safe_dump({"torque_controller": {"ros__parameters": rights}}))
    words = ["teach", "--folder", str(tmp_path / "s"), "--config", "geodude", "--config", str(file)]
    with (tmp_path / "terminal.log").open("wb") as output:
        terminal = subprocess.Popen(
            [sys.executable, "-m", "wam_power_ros.cli", *words],
            env=processes.environment,
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
    said = lambda: (tmp_path / "terminal.log").read_text()  # noqa: E731
    try:
        probe.until(lambda: "press Enter" in said(), "the question")
        probe.spin(OBSERVED)
        assert "torque" not in processes.output(driver)
        terminal.stdin.write(b"\n")
        terminal.stdin.flush()
        probe.until(lambda: "torque" in processes.output(driver), "a torque")
        probe.until(lambda: "Teaching: " in said(), "the next step")
    finally:
        terminal.send_signal(signal.SIGINT)
        terminal.wait(300.0)  # a busy machine
        sys.stdout.write(said())


@pytest.mark.requirement("S-101")
def test_a_recorder_with_the_plain_set_up_of_a_driver_records_that_drivers_arm(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    own = "demonstration_recorder.yaml"
    given = {"directory": tmp_path, "source": "sim"}  # a value of the command line stays
    processes.node(RECORDER, own, "libbarrett.yaml", "cobot.yaml", "reach.yaml", **given)
    request = GetParameters.Request(
        names=["joint_names", "driver_topics", "urdf", "body", "stem", "source"]
    )
    values = probe.call(GetParameters, "demonstration_recorder/get_parameters", request).values
    joints, topics, *texts = values
    assert joints.string_array_value == [f"cobot_joint{number}" for number in range(1, 8)]
    assert topics.string_array_value == ["joint_torque_commands", "wam/jointVelocity"]
    assert [text.string_value for text in texts] == ["urdf/cobot7.urdf", "", "reach", "sim"]
