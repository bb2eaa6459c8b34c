# SPDX-License-Identifier: Apache-2.0
"""Simulation: stand-ins, torque controller, tracker and recorder; `session` adds the learner.

    ros2 launch wam_power_ros sim.launch.py pace:=real_time
    ros2 launch wam_power_ros sim.launch.py session:=/tmp/flip demonstrations:=/tmp/bags/demo_1
    ros2 launch wam_power_ros sim.launch.py config:="geodude natnet_ros2"

With `config` the stand-ins behave like those devices: hardware.launch.py in simulation.

It runs in the domain of ROS_DOMAIN_ID, on this machine, and refuses to where a driver or another
session is. (`wam-power learn` takes a domain of its own.)
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from wam_power_ros.cli.launcher import task_setup
from wam_power_ros.params import overlay
from wam_power_ros.ros.domain import exported, hold

HELD = []  # the lock of the domain, until the launch ends
SECURE = "each node in its enclave of ROS_SECURITY_KEYSTORE, see SECURITY.md"


def nodes(context: LaunchContext) -> list[Node]:
    """Nodes to start, with one file that holds the parameters of all."""

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    names = given("config").split()
    simulated = bool(names) or given("pace") == "real_time"
    setup = overlay.setup(names, simulated, task_setup(given("task")))
    setup["wam_sim"]["seed"] = int(given("seed"))
    setup["learner"] |= {
        "session": given("session"),
        "task": given("task"),
        "demonstrations": given("demonstrations").split() or [""],
    }
    file = Path(tempfile.mkdtemp(prefix="wam_power_ros_")) / "parameters.yaml"
    file.write_text(overlay.text(setup))
    check_domain(file)
    executables = ["wam_sim", "torque_controller", "demonstration_recorder"]
    if setup["pancake_tracker"]["body"]:
        executables.append("pancake_tracker")
    if given("session"):
        executables.append("learner")
    return [
        Node(
            package="wam_power_ros",
            executable=name,
            parameters=[str(file)],
            output="screen",
            ros_arguments=["--enclave", f"/{name}"] if given("secure") == "true" else [],
            **({"on_exit": Shutdown()} if name in ("wam_sim", "torque_controller") else {}),
        )
        for name in executables
    ]


def check_domain(parameters: Path) -> None:
    """Refuse a domain in which a controller would hold a robot instead of the simulation.

    Raises:
        RuntimeError: A driver, another stand-in or another session is there.
    """
    HELD.append(hold(exported(os.environ)))
    command = [sys.executable, "-m", "hardware_sim.driver_watch", "--ros-args"]
    if subprocess.run([*command, "--params-file", str(parameters)]).returncode:
        raise RuntimeError("this domain is not free for a simulation, see above")


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
            DeclareLaunchArgument(
                "config", default_value="", description="set-ups to simulate, by name or path"
            ),
            DeclareLaunchArgument(
                "pace", default_value="lockstep", choices=["lockstep", "real_time"]
            ),
            DeclareLaunchArgument("seed", default_value="0"),
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
