# SPDX-License-Identifier: Apache-2.0
"""Replay a bag on the nodes that run: `ros2 run wam_power_ros replay BAG`.

In the domain and namespace of this terminal. Joint names, model and rules of the arm are those of
the running controller. Nothing is started or recorded; /recorder/record records.
"""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports, which a signal may interrupt
    from wam_power_ros.entry import INTERRUPTED, start

    raise SystemExit(start("wam_power_ros.console.replay_running", INTERRUPTED))

import argparse
from pathlib import Path

from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.utilities import remove_ros_args

from wam_power_ros.bags import reader
from wam_power_ros.client.link import LOG_AFTER, Link
from wam_power_ros.client.robot import Robot
from wam_power_ros.console.replay import replay
from wam_power_ros.control import replay_trajectory
from wam_power_ros.control.arm import Arm
from wam_power_ros.params.resources import robot_description
from wam_power_ros.ros.node_runner import run_script
from wam_power_ros.ros.outcomes import ServiceError

CONTROLLER = "torque_controller"  # node
APPEAR_TIMEOUT = 15.0  # [s of wall time] for its services to be discovered
OF_ARM = ("model_joint_names", "tool_frame", "base_frame", "position_limits")
NAMES = ("joint_names", "urdf", "simulation", *OF_ARM)


def replay_running(link: Link, bag: Path, speed: float) -> int:
    """Replay a bag on the running nodes; returns the exit status.

    Raises:
        ValueError: The bag is not acceptable, or of another arm.
        ServiceError: A service does not appear, does not answer in time, or refuses.
    """
    values = link.parameters(CONTROLLER, NAMES, APPEAR_TIMEOUT)
    if not values:
        raise ServiceError(
            f"no node {CONTROLLER} in this domain (ROS_DOMAIN_ID) and namespace answers: start the "
            "nodes, or use `wam-power replay`, which starts its own"
        )
    found = dict(zip(NAMES, map(parameter_value_to_python, values), strict=True))
    identity = None
    if found["urdf"]:
        urdf = robot_description(found["urdf"])
        names, tool, base, limits = (found[name] for name in OF_ARM)
        identity = Arm(urdf, names, tool, None, None, base, limits).identity()
    robot = Robot(link, joint_names=found["joint_names"])
    recorded = reader.read_demonstration(bag, robot.joint_names, arm=identity)
    movement = replay_trajectory.movement(*recorded, speed)
    return replay(robot, bag.name, *movement, speed, not found["simulation"], running=True)


def main() -> int:
    """Entry point of `ros2 run wam_power_ros replay`."""
    parser = argparse.ArgumentParser("replay", description=__doc__.partition("\n")[0])
    parser.add_argument("bag", type=Path, help="bag with the movement")
    parser.add_argument("--speed", type=float, default=1.0, help="relative to the recording")
    asked = parser.parse_args(remove_ros_args()[1:])

    def work(node: Node) -> int:
        with Link(node, log_period=LOG_AFTER) as link:
            return replay_running(link, asked.bag, asked.speed)

    return run_script(lambda: Node("robot"), work)
