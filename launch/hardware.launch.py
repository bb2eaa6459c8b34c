# SPDX-License-Identifier: Apache-2.0
"""The lab: the same nodes as the bench, no stand-ins; start the drivers of arm and cameras first.

    ros2 launch wam_power_ros hardware.launch.py driver:=geodude pose_topic:=/pancake/pose

`driver` names config/driver_<driver>.yaml, or is the path of a file of your own. The controller
does not start by itself here: `ros2 lifecycle set /torque_controller configure`, then `activate`.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

PACKAGE = "wam_power_ros"


def controller(context: LaunchContext) -> list[Node]:
    """The torque controller, once the driver's file is known."""
    config = Path(get_package_share_directory(PACKAGE)) / "config"
    driver = LaunchConfiguration("driver").perform(context)
    given = Path(driver).expanduser()
    overrides = given if given.suffix == ".yaml" else config / f"driver_{driver}.yaml"
    if not overrides.is_file():
        known = sorted(path.stem.removeprefix("driver_") for path in config.glob("driver_*.yaml"))
        raise ValueError(f"no driver set-up {overrides}; known: {known}, or give a .yaml file")
    return [
        Node(
            package=PACKAGE,
            executable="torque_controller",
            parameters=[
                str(config / "torque_controller.yaml"),
                str(overrides),
                {"autostart": False},
            ],
            output="screen",
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """See the module."""
    config = Path(get_package_share_directory(PACKAGE)) / "config"
    session = LaunchConfiguration("session")

    def node(name: str, **more: object) -> Node:
        return Node(
            package=PACKAGE,
            executable=name,
            parameters=[str(config / f"{name}.yaml")],
            output="screen",
            **more,
        )

    return LaunchDescription(
        [
            DeclareLaunchArgument("driver", description="name of a driver_*.yaml, or its path"),
            DeclareLaunchArgument("pose_topic", default_value="/pancake/pose"),
            DeclareLaunchArgument(
                "session", default_value="", description="folder; '': no learner"
            ),
            OpaqueFunction(function=controller),
            node(
                "pancake_tracker",
                remappings=[("/pancake/pose", LaunchConfiguration("pose_topic"))],
            ),
            node("demonstration_recorder"),
            node(
                "learner",
                ros_arguments=[
                    "-p",
                    ["learner:session:=", session],
                    "-p",
                    "learner:pancake_reset:=false",
                    "-p",
                    "learner:reset_faults:=false",
                ],
                condition=IfCondition(PythonExpression(["'", session, "' != ''"])),
            ),
        ]
    )
