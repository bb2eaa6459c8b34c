# SPDX-License-Identifier: Apache-2.0
"""A simulation and a robot never share a domain: the later one does not start."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from conftest import ROOT, Probe, Processes
from sensor_msgs.msg import JointState
from stand_ins import CONFIGS
from std_msgs.msg import String

from hardware_sim import driver_watch
from wam_power_ros.ros import interface, network

SIM = "hardware_sim.main"
DRIVER = """
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from wam_power_ros.ros import interface, network
rclpy.init()
node = Node("effort_controller")
node.create_subscription(
    Float64MultiArray, interface.EFFORT_COMMANDS, lambda _: None, interface.COMMAND
)
states = node.create_publisher(JointState, interface.JOINT_STATES, interface.STATE_OUT)
print("driver", flush=True)
rclpy.spin(node)
"""


def driver(processes: Processes) -> None:
    """Start a process like that of ros2_control."""
    process = processes.script(DRIVER)
    while "driver" not in processes.output(process):
        time.sleep(0.02)


def named(node: str, output: str) -> bool:
    """Whether a refusal names a node, whose name may be discovered later than its topics."""
    return any(
        f"{who} " in output for who in (f"node '{node}'", "a participant without a node name")
    )


@pytest.mark.requirement("S-55")
def test_beside_a_driver_a_simulation_refuses_to_run_and_publishes_nothing(
    probe: Probe, processes: Processes
) -> None:
    states = probe.listen(JointState, interface.JOINT_STATES, interface.STATE_RECORD)
    models = probe.listen(String, interface.ROBOT_DESCRIPTION, interface.LATCHED)
    driver(processes)
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
    driver(processes)
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
    hold = "import signal, sys; from wam_power_ros.ros.domain import lock; "
    free = next(number for number in range(102, 232) if number != domain_id)
    hold += "held = lock(int(sys.argv[1])); print('held', flush=True); signal.pause()"
    session = processes.script(hold, str(free))
    while "held" not in processes.output(session):
        time.sleep(0.02)
    command = [sys.executable, "-m", SIM, "--ros-args"]
    command += [word for name in CONFIGS for word in ("--params-file", str(ROOT / "config" / name))]
    refused = processes.start(command, ROS_DOMAIN_ID=str(free))
    assert refused.wait(60.0) == 2
    held = f"DDS domain {free} is in use on this machine by another session"
    assert held in processes.output(refused)


def graph(
    publisher: tuple[str, str, str] = ("/none", "", ""),
    subscriber: tuple[str, str, str] = ("/none", "", ""),
) -> SimpleNamespace:
    """A stand-in's node that sees one endpoint: its topic, namespace and node."""
    parameters = {
        "pace": "real_time",
        "state_topic": "arm/states",
        "command_topic": "commands",
        "listeners": ["plo"],
    }

    kind = driver_watch.STATE_TYPE if publisher[1] else "std_msgs/msg/String"

    def seen(asked: str, endpoint: tuple[str, str, str]) -> list[SimpleNamespace]:
        topic, namespace, node = endpoint
        return [SimpleNamespace(node_name=node, node_namespace=namespace)] * (asked == topic)

    return SimpleNamespace(
        publishers=[],
        get_namespace=lambda: "/left",
        get_name=lambda: "wam_sim",
        get_parameter=lambda name: SimpleNamespace(value=parameters[name]),
        resolve_topic_name=lambda name: name if name.startswith("/") else f"/left/{name}",
        get_topic_names_and_types=lambda: [(publisher[0], [kind])],
        get_publishers_info_by_topic=lambda asked: seen(asked, publisher),
        get_subscriptions_info_by_topic=lambda asked: seen(asked, subscriber),
    )


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """The steady clock of the watch, set by the test."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(driver_watch.time, "monotonic", lambda: clock.now)
    return clock


@pytest.mark.requirement("S-56")
def test_a_simulation_refuses_a_middleware_that_cannot_be_confined(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(network, "middleware", lambda: "rmw_zenoh_cpp")
    remedy = "rmw_zenoh_cpp.*RMW_IMPLEMENTATION=rmw_fastrtps_cpp"
    with pytest.raises(ValueError, match=remedy):
        driver_watch.DriverWatch(graph()).check()


@pytest.mark.requirement("S-55")
@pytest.mark.parametrize(
    ("kind", "endpoint", "robot"),
    [
        ("publisher", ("/right/joint_states", "/right", "driver"), "'driver' publishes /right/"),
        ("publisher", ("/left/arm/states", "/left", "wam_sim"), "'wam_sim' publishes /left/arm"),
        ("publisher", ("/right/arm/states", "/right", "wam_sim"), ""),
        ("subscriber", ("/left/commands", "/left", "driver"), "'driver' receives /left/commands"),
        ("subscriber", ("/effort_controller/commands", "/", "driver"), "'driver' receives /effort"),
        ("subscriber", ("/left/commands", "/left", "wam_sim"), ""),
        ("subscriber", ("/left/commands", "/left", "demonstration_recorder"), ""),
        ("subscriber", ("/left/commands", "/left", "plotter"), ""),
        ("subscriber", ("/left/commands", "/left", "rosbag2_recorder"), ""),
    ],
)
def test_who_publishes_states_or_receives_torques_is_a_robot_but_for_ours_and_named_listeners(
    kind: str, endpoint: tuple[str, str, str], robot: str, clock: SimpleNamespace
) -> None:
    watch = driver_watch.DriverWatch(graph(**{kind: endpoint}))
    clock.now = 1.0
    found = watch.look()
    assert robot in found and bool(found) == bool(robot)


@pytest.mark.requirement("S-55")
def test_a_publisher_of_another_namespace_is_given_time_to_be_named_and_one_of_ours_none(
    clock: SimpleNamespace,
) -> None:
    unnamed = driver_watch.UNNAMED
    elsewhere, ours = (
        driver_watch.DriverWatch(graph(publisher=(topic, unnamed, unnamed)))
        for topic in ("/right/joint_states", "/left/arm/states")
    )
    clock.now = 1.0
    assert elsewhere.look() == ""
    assert ours.look() == "a participant without a node name publishes /left/arm/states"
    clock.now = 0.9 + driver_watch.DISCOVERY_TIME
    assert elsewhere.look() == ""
    clock.now = 1.5 + driver_watch.DISCOVERY_TIME
    assert elsewhere.look() == "a participant without a node name publishes /right/joint_states"
