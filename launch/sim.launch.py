# SPDX-License-Identifier: Apache-2.0
"""Start the simulation: stand-ins, controller, tracker and recorder; with `session` the learner.

    ros2 launch wam_power_ros sim.launch.py pace:=real_time
    ros2 launch wam_power_ros sim.launch.py session:=/tmp/flip demonstrations:=/tmp/bags/demo_1
    ros2 launch wam_power_ros sim.launch.py config:="geodude natnet_ros2"

With `config` the stand-ins behave like those devices: hardware.launch.py in simulation.

It runs in the domain of ROS_DOMAIN_ID, on this machine. It refuses a domain with a driver or with
another session; simulations in other namespaces are allowed. (`wam-power learn` uses a separate
domain.)
"""

import sys
from pathlib import Path

from launch.actions import DeclareLaunchArgument

from launch import LaunchDescription

sys.path.insert(0, str(Path(__file__).parent))
import wam_power_plan


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and processes."""
    return wam_power_plan.description(
        "sim",
        DeclareLaunchArgument(
            "config", default_value="", description="set-ups to simulate, by name or path"
        ),
        DeclareLaunchArgument("pace", default_value="lockstep", choices=["lockstep", "real_time"]),
    )
