# SPDX-License-Identifier: Apache-2.0
"""Describe an arm by URDF and YAML alone, and see what the controller knows of it."""

from pathlib import Path

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import robot_description

# A set-up overrides parameters of config/*.yaml; this one limits the speed of a shipped set-up.
Path("slow.yaml").write_text(
    "torque_controller: {ros__parameters: {tool_speed_max: 0.5, move_speed: 0.1}}\n"
)
setup = overlay.setup(["cobot", "slow.yaml"])["torque_controller"]
names = setup["model_joint_names"]
arm = Arm(robot_description(setup["urdf"]), names, setup["tool_frame"], guarded=())

q = np.full(arm.n, 0.3)
position, _ = arm.tool_pose(q)
print(f"{setup['hardware_id']}: {arm.n} joints, tool at {position.round(3)} m")
for name, torque, limit in zip(names, arm.gravity(q), arm.tau_max, strict=True):
    print(f"{name}: {torque:6.2f} N m carry its weight, at most {limit:.0f} N m")
print(f"the tool may move at {setup['tool_speed_max']} m/s")
