# SPDX-License-Identifier: Apache-2.0
"""The launcher: parameters reach nodes, a task brings its set-up."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from wam_power_ros.cli.launcher import Devices
from wam_power_ros.cli.plan import Plan
from wam_power_ros.params import overlay
from wam_power_ros.params.driver_params import FrankaDriverParams


@pytest.mark.parametrize(
    ("names", "simulate", "first"),
    [
        ([], False, "wam_sim"),
        (["franka_fci"], False, "franka_driver"),
        (["franka_fci"], True, "wam_sim"),
        (["franka"], False, "torque_controller"),
    ],
)
def test_a_driver_of_ours_is_started_on_the_arm_whose_address_is_known(
    names: list[str], simulate: bool, first: str, tmp_path: Path
) -> None:
    devices = Devices(names, simulate)
    nodes = Plan(tmp_path, devices.parameters(), devices.stand_ins).nodes
    assert nodes[0] == first and len(nodes) == 2 + (first != "torque_controller")


def test_a_franka_with_another_number_of_joints_is_refused(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("franka_driver: {ros__parameters: {address: 10.0.0.1}}")
    with pytest.raises(ValueError, match=r"joint_names .* must be the robot's 7"):
        FrankaDriverParams.from_setup(overlay.setup(["ur", str(mine)]))


def test_the_printed_parameters_are_those_of_task_and_set_up(said: Callable[..., str]) -> None:
    nodes = yaml.safe_load(said("config", "--task", "reach", "--config", "geodude", "--simulate"))
    assert nodes["/**/learner"]["ros__parameters"]["task"] == "reach"
    assert nodes["/**/wam_sim"]["ros__parameters"]["joint_names"][6] == "right_j7"
