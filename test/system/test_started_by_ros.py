# SPDX-License-Identifier: Apache-2.0
"""Nodes started as `ros2 run` starts any: with a few parameters, and with another name."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from conftest import Probe, Process, Processes
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python

from wam_power_ros.params import overlay

MODULES = {
    "torque_controller": "wam_power_ros.nodes.torque_controller",
    "demonstration_recorder": "wam_power_ros.nodes.demonstration_recorder",
    "pancake_tracker": "wam_power_ros.nodes.body_tracker",
    "wam_sim": "hardware_sim.main",
}
OWN = overlay.from_files([])
# A file that a launch file writes for `parameters=[{...}]`, or a lab for all of its nodes.
TOOL = {"tool_frame": "wam_tool_plate"}
LAB = (
    "/**: {ros__parameters: {rate: 100.0, tool_frame: wam_tool_plate, move_speed: 0.4, trials: 3}}"
)
CHANGED = {
    "torque_controller": TOOL | {"move_speed": 0.4},
    "pancake_tracker": {"rate": 100.0},
    "demonstration_recorder": TOOL,
    "wam_sim": TOOL,
    "optitrack_sim": {"rate": 100.0},
}


def start(processes: Processes, node: str, *words: str) -> Process:
    return processes.start([sys.executable, "-m", MODULES[node], "--ros-args", *words])


def values(probe: Probe, name: str, names: list[str]) -> dict[str, object]:
    """Parameters of a running node; None for those that it does not have."""
    probe.until(lambda: name in probe.node.get_node_names(), f"node {name}")
    request = GetParameters.Request(names=names)
    found = probe.call(GetParameters, f"{name}/get_parameters", request).values
    plain = [parameter_value_to_python(value) for value in found]
    lists = [v if isinstance(v, (str, int, float)) else list(v) for v in plain]
    return dict(zip(names, lists, strict=True))


@pytest.mark.parametrize("node", ["torque_controller", "learner"])
def test_words_that_no_node_reads_are_refused(node: str, processes: Processes) -> None:
    command = [sys.executable, "-m", "wam_power_ros.entry", node, "-p", "move_speed:=0.1"]
    refused = processes.start(command)
    assert refused.wait(30.0) == 2
    text = "-p move_speed:=0.1: a node reads only what follows --ros-args"
    assert text in processes.output(refused)


@pytest.mark.parametrize("node", ["demonstration_recorder", "pancake_tracker"])
def test_a_node_takes_from_its_defaults_what_no_file_and_no_argument_says(
    node: str, probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text(LAB)
    start(processes, node, "--params-file", str(file))
    expected = OWN[node] | CHANGED[node]
    assert values(probe, node, [*expected]) == expected


@pytest.mark.parametrize("node", ["torque_controller", "wam_sim"])
def test_a_node_with_another_name_has_the_defaults_of_its_kind(
    node: str, probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text(LAB)
    start(processes, node, "-r", "__node:=other", "--params-file", str(file))
    expected = OWN[node] | CHANGED[node]
    assert values(probe, "other", [*expected]) == expected
    names = probe.node.get_node_names()
    assert node not in names
    assert ("optitrack_sim" in names) == (node == "wam_sim")
    if node == "wam_sim":  # what it does not know is the other stand-in's
        cameras = OWN["optitrack_sim"] | CHANGED["optitrack_sim"]
        assert values(probe, "optitrack_sim", [*cameras]) == cameras


def test_a_name_that_no_node_knows_is_refused_and_a_neighbour_named(
    processes: Processes, tmp_path: Path
) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text("/**: {ros__parameters: {raet: 100.0}}")
    process = start(processes, "pancake_tracker", "--params-file", str(file))
    assert process.wait(120.0) == 2
    assert "no parameter 'raet'; is it rate?" in processes.output(process)
