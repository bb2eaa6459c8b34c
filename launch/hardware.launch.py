# SPDX-License-Identifier: Apache-2.0
"""The lab: the same nodes as the bench, no stand-ins; start the drivers of arm and cameras first.

    ros2 launch wam_power_ros hardware.launch.py driver:=geodude pose_topic:=/pancake/pose

`driver` names config/driver_<driver>.yaml, or is the path of a file of your own. The controller
does not start by itself here: `ros2 lifecycle set /torque_controller configure`, then `activate`.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

PACKAGE = "wam_power_ros"


def nodes(context: LaunchContext) -> list[Node]:
    """Every node with its own file and the driver's over it, once that is known."""
    config = Path(get_package_share_directory(PACKAGE)) / "config"
    driver = LaunchConfiguration("driver").perform(context)
    given = Path(driver).expanduser()
    overrides = given if given.suffix == ".yaml" else config / f"driver_{driver}.yaml"
    if not overrides.is_file():
        known = sorted(path.stem.removeprefix("driver_") for path in config.glob("driver_*.yaml"))
        raise ValueError(f"no driver set-up {overrides}; known: {known}, or give a .yaml file")
    session = LaunchConfiguration("session").perform(context)

    def node(name: str, **more: object) -> Node:
        parameters = [str(config / f"{name}.yaml"), str(overrides), *more.pop("parameters", [])]
        return Node(
            package=PACKAGE, executable=name, parameters=parameters, output="screen", **more
        )

    started = [
        node("torque_controller", parameters=[{"autostart": False}]),
        node(
            "pancake_tracker",
            remappings=[("/pancake/pose", LaunchConfiguration("pose_topic"))],
        ),
        node("demonstration_recorder"),
    ]
    if session:
        demonstrations = LaunchConfiguration("demonstrations").perform(context).split()
        given = {"session": session, "demonstrations": demonstrations or [""]}
        started.append(node("learner", parameters=[given]))
    return started


def generate_launch_description() -> LaunchDescription:
    """See the module."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("driver", description="name of a driver_*.yaml, or its path"),
            DeclareLaunchArgument("pose_topic", default_value="/pancake/pose"),
            DeclareLaunchArgument(
                "session", default_value="", description="folder; '': no learner"
            ),
            DeclareLaunchArgument(
                "demonstrations", default_value="", description="bags a new session begins from"
            ),
            OpaqueFunction(function=nodes),
        ]
    )
