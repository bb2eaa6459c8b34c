# SPDX-License-Identifier: Apache-2.0
"""The enclave of the operator allows the commands in `docs/hardware.md`, and no others."""

from __future__ import annotations

import importlib.util
import re
import shlex
import signal
import sys
from collections.abc import Iterator
from fnmatch import fnmatchcase

import pytest
from conftest import ROOT, Probe, Processes
from rclpy.lifecycle import LifecycleNode
from rights import RIGHTS
from sensor_msgs.msg import JointState

from wam_power_ros.ros import interface

TYPED = re.compile(r"^ros2 (?:topic|service|lifecycle|param) .*", re.MULTILINE)
DOCS = [*sorted((ROOT / "docs").glob("*.md")), ROOT / "SECURITY.md"]
COMMANDS = sorted({line for file in DOCS for line in TYPED.findall(file.read_text())})
SERVICES = {  # verb of `ros2 lifecycle` -> services that it calls
    "set": ("get_available_transitions", "change_state"),
    "get": ("get_state",),
}
CLI = "import sys; from ros2cli.cli import main; sys.exit(main())"
needs_ros2 = pytest.mark.skipif(
    importlib.util.find_spec("ros2lifecycle") is None, reason="ros2cli is not installed"
)


def refused(names: set[str], kind: str, right: str) -> set[str]:
    """Names that no expression matches, as the middleware matches them."""
    expressions = RIGHTS["operator"][kind, right]
    return {name for name in names if not any(fnmatchcase(name, each) for each in expressions)}


def needed(command: str) -> Iterator[tuple[str, str, str]]:
    """Kind, right and name of what a command does."""
    _, group, verb, name, *_ = shlex.split(command, comments=True)
    if group == "topic":
        yield "topic", "publish" if verb == "pub" else "subscribe", name
    elif group == "service":
        yield "service", "request", name
    else:
        yield from (("service", "request", f"{name}/{each}") for each in SERVICES[verb])


def test_a_documented_command_is_within_the_rights_of_the_operator() -> None:
    assert {command.split()[1] for command in COMMANDS} >= {"topic", "service", "lifecycle"}
    for command in COMMANDS:
        for kind, right, name in needed(command):
            assert refused({name}, kind, right) == set(), command


def test_torques_and_policies_are_not() -> None:
    assert refused({"/effort_controller/commands", "/policy"}, "topic", "publish")
    assert refused({"/torque_controller/set_parameters"}, "service", "request")


@needs_ros2
@pytest.mark.parametrize("command", COMMANDS)
def test_all_that_the_node_of_a_command_does_is_within_them(
    command: str, probe: Probe, processes: Processes
) -> None:
    managed = LifecycleNode("torque_controller", context=probe.context)  # never answers
    words = shlex.split(command, comments=True)[1:]
    probe.node.create_publisher(JointState, interface.JOINT_STATES, interface.STATE_OUT)
    direct = ["--no-daemon", "--spin-time", "5"] if words[0] == "lifecycle" else []
    process = processes.start([sys.executable, "-c", CLI, *words, *direct])
    expected = {(kind, right, name) for kind, right, name in needed(command)}
    if words[:2] == ["lifecycle", "set"]:  # the first is not answered here
        expected = {item for item in expected if not item[2].endswith("change_state")}
    seen: set[tuple[str, str, str]] = set()

    def complete() -> bool:
        for name, namespace in probe.node.get_node_names_and_namespaces():
            if name.startswith("_ros2cli"):
                seen.update(done(probe, name, namespace))
        return expected <= seen and any("get_type_description" in item[2] for item in seen)

    probe.until(complete, f"what {command} does")
    processes.end(process, signal.SIGKILL)
    managed.destroy_node()
    for kind, right, name in seen:
        assert refused({name}, kind, right) == set(), (kind, right, name)


def done(probe: Probe, name: str, namespace: str) -> Iterator[tuple[str, str, str]]:
    """Kind, right and name of everything a node has on the network."""
    node = probe.node
    for kind, right, ask in (
        ("topic", "publish", node.get_publisher_names_and_types_by_node),
        ("topic", "subscribe", node.get_subscriber_names_and_types_by_node),
        ("service", "reply", node.get_service_names_and_types_by_node),
        ("service", "request", node.get_client_names_and_types_by_node),
    ):
        yield from ((kind, right, found) for found, _ in ask(name, namespace))
