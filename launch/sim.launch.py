# SPDX-License-Identifier: Apache-2.0
"""The bench: stand-ins, torque controller, tracker and recorder; `session` adds the learner.

ros2 launch wam_power_ros sim.launch.py pace:=real_time
ros2 launch wam_power_ros sim.launch.py session:=/tmp/flip demonstrations:="['/tmp/bags/demo_1']"
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

PACKAGE = "wam_power_ros"


def generate_launch_description() -> LaunchDescription:
    """See the module."""
    config = Path(get_package_share_directory(PACKAGE)) / "config"
    pace, session = LaunchConfiguration("pace"), LaunchConfiguration("session")
    lockstep = ParameterValue(PythonExpression(["'", pace, "' == 'lockstep'"]), value_type=bool)

    def node(name: str, **more: object) -> Node:
        files = [str(config / f"{name}.yaml")]
        return Node(
            package=PACKAGE,
            executable=name,
            parameters=[*files, {"use_sim_time": lockstep}],
            output="screen",
            **more,
        )

    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "pace", default_value="lockstep", choices=["lockstep", "real_time"]
            ),
            DeclareLaunchArgument("seed", default_value="0"),
            DeclareLaunchArgument(
                "session", default_value="", description="folder; '': no learner"
            ),
            DeclareLaunchArgument(
                "demonstrations", default_value="['']", description="bags a new session begins from"
            ),
            Node(  # one process, two nodes: its parameters are addressed to the one they are for
                package=PACKAGE,
                executable="wam_sim",
                parameters=[str(config / "wam_sim.yaml"), str(config / "optitrack_sim.yaml")],
                ros_arguments=[
                    "-p",
                    ["wam_sim:pace:=", pace],
                    "-p",
                    ["wam_sim:seed:=", LaunchConfiguration("seed")],
                ],
                output="screen",
                on_exit=Shutdown(),
            ),
            node("torque_controller", on_exit=Shutdown()),
            node("pancake_tracker"),
            node("demonstration_recorder"),
            node(
                "learner",
                ros_arguments=[
                    "-p",
                    ["learner:session:=", session],
                    "-p",
                    ["learner:demonstrations:=", LaunchConfiguration("demonstrations")],
                ],
                condition=IfCondition(PythonExpression(["'", session, "' != ''"])),
            ),
        ]
    )
