# SPDX-License-Identifier: Apache-2.0
"""Start the nodes on the real arm, without stand-ins. Start the drivers of arm and cameras first.

    ros2 launch wam_power_ros hardware.launch.py config:="geodude natnet_ros2"

`config` names set-ups, config/NAME.yaml or paths of your own files; later ones override earlier
ones. A person activates the controller: `ros2 lifecycle set /torque_controller configure`, then
`activate`; a learner waits for it. (`wam-power`, for machines without `ros2`, asks for Enter
instead.)
"""

import sys
from pathlib import Path

from launch.actions import DeclareLaunchArgument

from launch import LaunchDescription

sys.path.insert(0, str(Path(__file__).parent))
import wam_power_plan


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and processes."""
    config = DeclareLaunchArgument("config", description="set-ups, by name or path")
    return wam_power_plan.description("hardware", config)
