# SPDX-License-Identifier: Apache-2.0
"""A simulation and a robot never share a domain: the later one does not start."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT, Probe, Processes
from sensor_msgs.msg import JointState
from stand_ins import CONFIGS, NAMES
from std_msgs.msg import Float64MultiArray, String

from hardware_sim import driver_watch
from wam_power_ros.ros import interface, joint_messages

SIM = "hardware_sim.main"
DRIVER = """
import sys, time
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from wam_power_ros.ros import interface
rclpy.init()
node = Node("effort_controller")
node.create_subscription(
    Float64MultiArray, interface.EFFORT_COMMANDS, lambda _: None, interface.COMMAND
)
if "states" in sys.argv:
    states = node.create_publisher(JointState, interface.JOINT_STATES, interface.STATE_OUT)
print("driver", flush=True)
rclpy.spin(node)
"""


def driver(processes: Processes, *kinds: str) -> None:
    """Start a process like that of ros2_control; without states it only subscribes."""
    process = processes.script(DRIVER, *kinds)
    while "driver" not in processes.output(process):
        time.sleep(0.02)


def named(node: str, output: str) -> bool:
    """Whether a refusal names a node, whose name may be discovered later than its topics."""
    return any(
        f"{who} " in output for who in (f"node '{node}'", "a participant without a node name")
    )


@pytest.mark.requirement("S-55")
@pytest.mark.parametrize(
    "kinds",
    [("states",), (), ("states", "--ros-args", "-r", "__ns:=/right")],
    ids=["states", "only commands", "in another namespace"],
)
def test_beside_a_driver_a_simulation_refuses_to_run_and_publishes_nothing(
    kinds: tuple[str, ...], probe: Probe, processes: Processes
) -> None:
    states = probe.listen(JointState, interface.JOINT_STATES, interface.STATE_RECORD)
    models = probe.listen(String, interface.ROBOT_DESCRIPTION, interface.LATCHED)
    driver(processes, *kinds)
    refused = processes.node(SIM, *CONFIGS)
    probe.until(lambda: refused.poll() is not None, "a refusal")
    assert refused.returncode == 2
    assert named("effort_controller", processes.output(refused))
    assert "a simulation must not share a domain with a robot" in processes.output(refused)
    assert "Traceback" not in processes.output(refused)
    assert states == models == []


@pytest.mark.requirement("S-55")
def test_a_simulation_ends_when_a_driver_appears(probe: Probe, processes: Processes) -> None:
    states = probe.listen(JointState, interface.JOINT_STATES, interface.STATE_RECORD)
    simulation = processes.node(SIM, *CONFIGS)
    probe.until(lambda: states, "a state")
    driver(processes, "states")
    probe.until(lambda: simulation.poll() is not None, "its end", 20.0)
    assert simulation.returncode == 2
    assert named("effort_controller", processes.output(simulation))


@pytest.mark.requirement("S-55")
def test_a_second_simulation_is_refused_and_the_first_goes_on(
    probe: Probe, processes: Processes
) -> None:
    states = probe.listen(JointState, interface.JOINT_STATES, interface.STATE_RECORD)
    first = processes.node(SIM, *CONFIGS)
    probe.until(lambda: states, "a state")
    second = processes.node(SIM, *CONFIGS)
    assert second.wait(60.0) == 2
    assert named("wam_sim", processes.output(second))
    states.clear()
    probe.until(lambda: len(states) > 2, "more states of the first")
    assert first.poll() is None


@pytest.mark.requirement("S-55")
def test_a_domain_that_another_session_holds_is_refused_at_once(
    processes: Processes, domain_id: int, tmp_path: Path
) -> None:
    hold = "import signal, sys; from wam_power_ros.ros.domain import hold; "
    free = next(number for number in range(102, 232) if number != domain_id)
    hold += "lock = hold(int(sys.argv[1])); print('held', flush=True); signal.pause()"
    session = processes.script(hold, str(free))
    while "held" not in processes.output(session):
        time.sleep(0.02)
    command = [sys.executable, "-m", SIM, "--ros-args"]
    command += [word for name in CONFIGS for word in ("--params-file", str(ROOT / "config" / name))]
    refused = processes.start(command, ROS_DOMAIN_ID=str(free))
    assert refused.wait(60.0) == 2
    held = f"DDS domain {free} is in use on this machine by another session"
    assert held in processes.output(refused)


@pytest.mark.requirement("S-55")
def test_a_plot_may_listen_when_it_is_named(probe: Probe, processes: Processes) -> None:
    torques = probe.listen(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND)
    states = probe.listen(JointState, interface.JOINT_STATES, interface.STATE_RECORD)
    processes.node(SIM, *CONFIGS, **{"wam_sim:listeners": "[pro]"})
    probe.until(lambda: len(states) > 2, "states")
    publisher = probe.publisher(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND)
    write = joint_messages.TorqueWriter(NAMES, "multiarray")
    publisher.publish(write(0, "hold", np.zeros(7)))
    probe.until(lambda: torques, "a torque at the plot")


PARAMETERS = {
    "pace": "real_time",
    "state_topic": "arm/states",
    "command_topic": "commands",
    "listeners": [],
}


def graph(topic: str) -> SimpleNamespace:
    """A node that sees one publisher of joint states without a node name."""
    unnamed = driver_watch.UNNAMED
    seen = SimpleNamespace(node_name=unnamed, node_namespace=unnamed)
    return SimpleNamespace(
        publishers=[],
        get_namespace=lambda: "/left",
        get_name=lambda: "wam_sim",
        get_parameter=lambda name: SimpleNamespace(value=PARAMETERS[name]),
        resolve_topic_name=lambda name: f"/left/{name}",
        get_topic_names_and_types=lambda: [(topic, [driver_watch.STATE_TYPE])],
        get_subscriptions_info_by_topic=lambda _: [],
        get_publishers_info_by_topic=lambda asked: [seen] if asked == topic else [],
    )


@pytest.mark.requirement("S-55")
def test_a_publisher_of_another_namespace_is_given_time_to_be_named_and_one_of_ours_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0
    monkeypatch.setattr(driver_watch.time, "monotonic", lambda: now)
    elsewhere = driver_watch.DriverWatch(graph("/right/joint_states"))
    ours = driver_watch.DriverWatch(graph("/left/arm/states"))
    now = 1.0
    assert elsewhere.look() == ""
    assert ours.look() == "a participant without a node name publishes /left/arm/states"
    now = 0.9 + driver_watch.DISCOVERY_TIME
    assert elsewhere.look() == ""
    now = 1.5 + driver_watch.DISCOVERY_TIME
    assert elsewhere.look() == "a participant without a node name publishes /right/joint_states"
