# SPDX-License-Identifier: Apache-2.0
"""Real arm: the nodes without stand-ins; start the drivers of arm and cameras first.

    ros2 launch wam_power_ros hardware.launch.py config:="geodude natnet_ros2"

`config` names set-ups, config/NAME.yaml or paths of your own files; later ones override earlier
ones. The controller is not activated by itself: `ros2 lifecycle set /torque_controller configure`,
then `activate`. (`wam-power`, for machines without `ros2`, asks for Enter instead.)
"""

import os
import tempfile
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from wam_power_ros.cli.launcher import task_setup
from wam_power_ros.params import overlay

SECURE = "each node in its enclave of ROS_SECURITY_KEYSTORE, see SECURITY.md"


def nodes(context: LaunchContext) -> list[Node]:
    """Nodes to start, with one file that holds the parameters of all."""

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    setup = overlay.setup(given("config").split(), task=task_setup(given("task")))
    setup["torque_controller"]["autostart"] = False
    setup["learner"] |= {
        "session": given("session"),
        "task": given("task"),
        "demonstrations": given("demonstrations").split() or [""],
    }
    file = Path(tempfile.mkdtemp(prefix="wam_power_ros_")) / "parameters.yaml"
    file.write_text(overlay.text(setup))
    names = ["torque_controller", "demonstration_recorder"]
    if setup["pancake_tracker"]["body"]:
        names.append("pancake_tracker")
    if given("session"):
        names.append("learner")
    return [
        Node(
            package="wam_power_ros",
            executable=name,
            parameters=[str(file)],
            output="screen",
            ros_arguments=["--enclave", f"/{name}"] if given("secure") == "true" else [],
        )
        for name in names
    ]


def generate_launch_description() -> LaunchDescription:
    """Arguments and nodes, see the module."""
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return LaunchDescription(
        [
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", reach),
            DeclareLaunchArgument(
                "secure", default_value="false", choices=["true", "false"], description=SECURE
            ),
            SetEnvironmentVariable("ROS_SECURITY_ENABLE", LaunchConfiguration("secure")),
            SetEnvironmentVariable("ROS_SECURITY_STRATEGY", "Enforce"),
            DeclareLaunchArgument("config", description="set-ups, by name or path"),
            DeclareLaunchArgument("task", default_value="flip", description="skill to be learnt"),
            DeclareLaunchArgument(
                "session", default_value="", description="folder; '': no learner"
            ),
            DeclareLaunchArgument(
                "demonstrations", default_value="", description="bags a new session begins from"
            ),
            OpaqueFunction(function=nodes),
        ]
    )
