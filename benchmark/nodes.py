# SPDX-License-Identifier: Apache-2.0
"""The arm of the benchmarks; command lines and environment of the nodes that they start."""

from __future__ import annotations

import json
import os
import sys
from functools import cache
from pathlib import Path

from wam_power_ros.bags import reader
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.demonstration import from_joint_samples
from wam_power_ros.learning.dmp import fit
from wam_power_ros.learning.policy import Policy
from wam_power_ros.params.resources import share
from wam_power_ros.ros.domain import shared
from wam_power_ros.tasks.flip.settings import FLIP_FIT

ROOT = Path(__file__).resolve().parents[1]
JOINTS = [f"wam_j{number}" for number in range(1, 8)]
PERIOD_NS = 2_000_000


@cache
def taught() -> Policy:
    """Policy fitted to the first shipped demonstration of the flip."""
    bag = min(share("bags").glob("demo_*"))
    arm = Arm(share("urdf/wam7.urdf").read_text(), JOINTS)
    return fit([from_joint_samples(arm, *reader.read_demonstration(bag, JOINTS))], FLIP_FIT, "flip")


def environment(domain: int | None = None) -> dict[str, str]:
    """Environment of a node: this checkout, this machine only, and a DDS domain if one is given."""
    given = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
    }
    return given if domain is None else given | shared(domain)


def ros_arguments(name: str, *configs: str, **parameters: object) -> list[str]:
    """ROS arguments with the parameter files of a node and of others, and single values."""
    words = ["--ros-args"]
    for config in (name, *configs):
        words += ["--params-file", f"{ROOT}/config/{config}.yaml"]
    for key, value in parameters.items():
        words += ["-p", f"{name}:{key}:={json.dumps(value)}"]
    return words


def node_command(name: str, *configs: str, **parameters: object) -> list[str]:
    """Command that runs a node; arguments as for `ros_arguments`."""
    command = [sys.executable, "-m", "wam_power_ros.cli", "run", name]
    return [*command, *ros_arguments(name, *configs, **parameters)]
