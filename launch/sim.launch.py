# SPDX-License-Identifier: Apache-2.0
"""Start the simulation: stand-ins, controller, tracker and recorder; with `session` the learner.

    ros2 launch wam_power_ros sim.launch.py pace:=real_time
    ros2 launch wam_power_ros sim.launch.py session:=/tmp/flip demonstrations:=/tmp/bags/demo_1
    ros2 launch wam_power_ros sim.launch.py config:="geodude natnet_ros2" pace:=real_time

The arguments are those of hardware.launch.py; with `config` the stand-ins behave like those
devices. It runs in the domain of ROS_DOMAIN_ID, on this machine. The stand-in refuses a domain with
a driver or with another session, and ends the launch; simulations in other namespaces are allowed.
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and nodes."""
    file = PythonLaunchDescriptionSource(str(Path(__file__).with_name("hardware.launch.py")))
    pace = {"simulate": LaunchConfiguration("pace")}
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "pace", default_value="lockstep", choices=["lockstep", "real_time"]
            ),
            IncludeLaunchDescription(file, launch_arguments=pace.items()),
        ]
    )
