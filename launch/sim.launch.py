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

import subprocess
import sys
from pathlib import Path

from launch.actions import DeclareLaunchArgument

from launch import LaunchDescription
from wam_power_ros.cli import ros_launch
from wam_power_ros.entry import INTERRUPTED


def check_domain(plan: ros_launch.LaunchPlan, parameters: Path) -> bool:
    """Refuse a domain in which a controller would command a robot instead of the simulation.

    Returns:
        False after Ctrl-C.

    Raises:
        RuntimeError: A driver, another stand-in or another session uses this domain.
    """
    command = [sys.executable, "-m", "hardware_sim.driver_watch", "--ros-args"]
    command += ["--params-file", str(parameters), "-r", f"__ns:={plan.namespace or '/'}"]
    for old, new in plan.remappings:
        command += ["-r", f"{old}:={new}"]
    status = subprocess.run(command).returncode
    if status not in (0, INTERRUPTED):
        raise RuntimeError("this domain is not free for a simulation, see above")
    return status == 0


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and nodes."""
    arguments = [
        DeclareLaunchArgument(
            "config", default_value="", description="set-ups to simulate, by name or path"
        ),
        DeclareLaunchArgument("pace", default_value="lockstep", choices=["lockstep", "real_time"]),
    ]
    return ros_launch.description(arguments, stand_ins=True, check=check_domain)
