# SPDX-License-Identifier: Apache-2.0
"""Code shared by the launch files of launch/: arguments, parameters, nodes, end of a session.

A launch ends when its learner has ended and the report of the session is written, when one of
`REQUIRED_NODES` ends, or when a node refuses its parameters; with status 1 unless that node ended
by itself with status 0. Other nodes are restarted. A launch holds its DDS domain. `launch` is
imported where it is used, because machines without ROS lack it.
"""

from __future__ import annotations

import argparse
import atexit
import os
import re
import shlex
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import yaml

from wam_power_ros.cli.launcher import DOMAIN_FILE, discovery_range, folder_lock, task_setup
from wam_power_ros.cli.session_options import DEFAULT_TASK, check_names, session_folder
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import share
from wam_power_ros.ros import interface
from wam_power_ros.ros.domain import exported, hold

if TYPE_CHECKING:
    from launch.actions import DeclareLaunchArgument
    from launch.events.process import ProcessExited
    from launch.launch_description_entity import LaunchDescriptionEntity

    from launch import LaunchContext, LaunchDescription

END_TIMEOUT = "30.0"  # [s] for a node to close its bag or bring the arm to rest
NAMESPACE = re.compile(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
REQUIRED_NODES = ("wam_sim", "torque_controller")
LOCKS: list[ExitStack | None] = []  # of DDS domain and session, held until the launch ends
RESPAWN_DELAY = 1.0  # [s], enough for Ctrl-C in the terminal to reach launch too
SHARED_ARGUMENTS = {  # launch argument -> default and description
    "namespace": ("", "namespace of the nodes, topics, services and frames of one arm"),
    "task": ("", "skill to learn; '': the session's, or flip"),
    "session": ("", "folder of a session to start or resume; '': no learner"),
    "demonstrations": ("", "bags of a new session; quote paths with spaces"),
    "learner": ("", "learning algorithm; '': the preset's"),
    "preset": ("", "settings of the task; '': its first"),
    "trials": ("", "budget of rollouts; '': the preset's"),
    "seed": ("", "seed of a new session and of the simulation; '': the session's, or 0"),
}
SECURE_TEXT = "run each node in its enclave of ROS_SECURITY_KEYSTORE, see SECURITY.md"


class LaunchPlan(NamedTuple):
    """Nodes and parameters that a launch file starts.

    Attributes:
        setup: Parameters by node.
        executables: Nodes to start.
        session: Folder of the session; None without a learner.
        namespace: Namespace of the nodes, such as `/left`; empty for none.
    """

    setup: overlay.Setup
    executables: tuple[str, ...]
    session: Path | None
    namespace: str = ""

    @property
    def remappings(self) -> list[tuple[str, str]]:
        """Names to remap in a namespace: each simulation has its own clock."""
        return [("/clock", f"{self.namespace}/clock")] if self.namespace else []


def prepare(given: Mapping[str, str], stand_ins: bool) -> LaunchPlan:
    """Turn launch arguments into a plan.

    Args:
        given: Values of the launch arguments, by name.
        stand_ins: True to start the simulated devices too, false on hardware.

    Raises:
        UsageError, ValueError: An argument is invalid or contradicts the session.
    """
    from wam_power_ros.practice import session as sessions

    bags = [Path(bag).expanduser().resolve() for bag in _words(given, "demonstrations")]
    names = _words(given, "config")
    if not (stand_ins or names):
        raise ValueError("config is empty: name the set-up of the arm's driver, such as geodude")
    simulated = stand_ins and (bool(names) or given["pace"] == "real_time")
    session, task, asked = None, given["task"] or DEFAULT_TASK, _whole_number(given, "seed")
    seed = asked or 0
    learner: dict[str, object] = {"session": ""}
    if given["session"]:
        options = argparse.Namespace(
            session=Path(given["session"]).expanduser(),
            resume=False,
            seed=asked,
            task=given["task"] or None,
            learner=given["learner"],
            preset=given["preset"],
            trials=_whole_number(given, "trials"),
            bags=bags,
            demonstrations=0,
            config=names,
            simulate=simulated,
        )
        session = session_folder(options)
        if sessions.Session.exists(session):
            header, _, _ = sessions.read(session)
            seed, task = header.seed, header.settings.task
        else:
            check_names(task, options)
        learner = {
            "session": str(session),
            "seed": seed,
            "demonstrations": [str(bag) for bag in bags] or [""],
            "learner": given["learner"],
            "preset": given["preset"],
            "trials": options.trials or 0,
        }
    setup = overlay.setup(names, simulated, task_setup(task))
    setup = setup.changed({"learner": {**learner, "task": task}})
    if session is not None:
        setup["demonstration_recorder"]["directory"] = str(session / "bags")
    executables = ["torque_controller", "demonstration_recorder"]
    if stand_ins:
        setup["wam_sim"]["seed"] = seed
        executables.insert(0, "wam_sim")
    if setup["pancake_tracker"]["body"]:
        executables.append("pancake_tracker")
    if session is not None:
        executables.append("learner")
    return LaunchPlan(setup, tuple(executables), session, _namespace(given["namespace"]))


def _words(given: Mapping[str, str], name: str) -> list[str]:
    """Names or paths in a launch argument, quoted as in a shell.

    Raises:
        ValueError: A quotation is not closed.
    """
    try:
        return shlex.split(given[name])
    except ValueError as error:
        raise ValueError(f"{name} {given[name]!r}: {error}") from None


def _whole_number(given: Mapping[str, str], name: str) -> int | None:
    """Whole number in a launch argument; None if it is empty.

    Raises:
        ValueError: It is not a whole number of at least 0.
    """
    text = given[name].strip()
    if text and not text.isdecimal():
        raise ValueError(f"{name} {text!r} must be a whole number of at least 0")
    return int(text) if text else None


def _namespace(text: str) -> str:
    """Namespace in a launch argument, with a leading slash; empty for none.

    Raises:
        ValueError: It is not a valid ROS name.
    """
    name = text.strip("/")
    if name and not NAMESPACE.fullmatch(name):
        raise ValueError(
            f"namespace {text!r} must be names of letters, digits and underscores, separated by /"
        )
    return f"/{name}" if name else ""


def parameter_file(plan: LaunchPlan) -> Path:
    """Write the parameters of all nodes into the session, else into a temporary folder.

    Raises:
        UsageError: Another launcher or a learner holds the session.
    """
    if plan.session is not None:
        lock = ExitStack()
        lock.enter_context(folder_lock(plan.session))
        LOCKS.append(lock)
        folder = plan.session / "logs"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / DOMAIN_FILE).unlink(missing_ok=True)  # left by `wam-power learn`
    else:
        folder = Path(tempfile.mkdtemp(prefix="wam_power_ros_"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    file = folder / "parameters.yaml"
    file.write_text(overlay.text(plan.setup, plan.namespace), encoding="utf-8")
    return file


def arm_description(plan: LaunchPlan) -> dict[str, object] | None:
    """Parameters of robot_state_publisher; None without a URDF with the driver's joint names."""
    arm = plan.setup["torque_controller"]
    if not arm["urdf"] or arm["joint_names"] != arm["model_joint_names"]:
        return None
    return {
        "robot_description": share(arm["urdf"]).read_text(),
        "frame_prefix": f"{plan.namespace}/".lstrip("/"),
        "use_sim_time": bool(arm.get("use_sim_time", False)),
    }


def rviz_file(namespace: str) -> str:
    """RViz configuration for the arm in a namespace, such as `/left`; empty for none."""
    whole = yaml.safe_load(share("config/visualization/session.rviz").read_text())
    manager = whole["Visualization Manager"]
    frames = manager["Global Options"]
    frames["Fixed Frame"] = interface.frame(namespace, frames["Fixed Frame"])
    for display in manager["Displays"]:
        for key in ("Topic", "Description Topic"):
            if key in display:
                display[key]["Value"] = namespace + display[key]["Value"]
        if "TF Prefix" in display:
            display["TF Prefix"] = namespace.lstrip("/")
    return yaml.safe_dump(whole, sort_keys=False)


def description(
    arguments: list[DeclareLaunchArgument],
    stand_ins: bool,
    check: Callable[[LaunchPlan, Path], bool] = lambda plan, file: True,
) -> LaunchDescription:
    """Description of a launch file.

    Args:
        arguments: Arguments of this launch file, besides `SHARED_ARGUMENTS`.
        stand_ins: True to start the simulated devices too, false on hardware.
        check: Function of plan and parameter file, called first; if it returns false, nothing is
            started.
    """
    from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
    from launch.substitutions import LaunchConfiguration

    from launch import LaunchDescription

    declared = [
        *arguments,
        *(
            DeclareLaunchArgument(name, default_value=default, description=text)
            for name, (default, text) in SHARED_ARGUMENTS.items()
        ),
        DeclareLaunchArgument(
            "secure",
            default_value="false",
            choices=["true", "false"],
            description=SECURE_TEXT,
        ),
        DeclareLaunchArgument(
            "rviz", default_value="false", choices=["true", "false"], description="start RViz too"
        ),
    ]

    def start(context: LaunchContext) -> list[LaunchDescriptionEntity]:
        values = {each.name: LaunchConfiguration(each.name).perform(context) for each in declared}
        plan = prepare(values, stand_ins)
        LOCKS.append(hold(exported(os.environ), plan.namespace))
        file = parameter_file(plan)
        if not check(plan, file):
            return []
        nodes = _nodes(plan, file, values["secure"] == "true")
        return nodes + _display_nodes(plan, file, stand_ins, values["rviz"] == "true")

    return LaunchDescription(
        [
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", discovery_range(os.environ)),
            *declared,
            SetEnvironmentVariable("ROS_SECURITY_ENABLE", LaunchConfiguration("secure")),
            SetEnvironmentVariable("ROS_SECURITY_STRATEGY", "Enforce"),
            OpaqueFunction(function=start),
        ]
    )


def _nodes(plan: LaunchPlan, file: Path, secure: bool) -> list[LaunchDescriptionEntity]:
    from launch.actions import ExecuteProcess, Shutdown
    from launch_ros.actions import Node

    from wam_power_ros.ros.node_runner import REFUSED

    def end_launch(event: ProcessExited, context: LaunchContext) -> list[LaunchDescriptionEntity]:
        if context.is_shutdown:
            return []
        _check(event)
        return [Shutdown(reason=f"{event.process_name} has ended")]

    def write_report(event: ProcessExited, context: LaunchContext) -> list[LaunchDescriptionEntity]:
        if context.is_shutdown:
            return []
        _check(event)
        command = [sys.executable, "-m", "wam_power_ros.cli", "report", str(plan.session)]
        ended = Shutdown(reason="the session has ended")
        return [ExecuteProcess(cmd=command, name="report", output="screen", on_exit=[ended])]

    def end_if_refused(event: ProcessExited, context: LaunchContext) -> None:
        if event.returncode == REFUSED and not context.is_shutdown:
            _check(event)

    ends = {name: end_launch for name in REQUIRED_NODES} | {"learner": write_report}
    return [
        Node(
            package="wam_power_ros",
            executable=name,
            namespace=plan.namespace,
            remappings=plan.remappings,
            parameters=[str(file)],
            output="screen",
            ros_arguments=["--enclave", f"{plan.namespace}/{name}"] if secure else [],
            sigterm_timeout=END_TIMEOUT,
            sigkill_timeout=END_TIMEOUT,
            on_exit=ends.get(name, end_if_refused),
            respawn=name not in ends,
            respawn_delay=RESPAWN_DELAY,
        )
        for name in plan.executables
    ]


def _check(event: ProcessExited) -> None:
    """Raise RuntimeError, which ends the launch with status 1, if a process has failed."""
    if event.returncode:
        raise RuntimeError(f"{event.process_name} ended with status {event.returncode}, see above")


def _display_nodes(
    plan: LaunchPlan, file: Path, stand_ins: bool, rviz: bool
) -> list[LaunchDescriptionEntity]:
    """RViz if requested; robot_state_publisher in simulation, where it is installed."""
    from ament_index_python.packages import get_packages_with_prefixes
    from launch_ros.actions import Node

    common = {"namespace": plan.namespace, "output": "log"}
    arm = plan.setup["torque_controller"]
    described = arm_description(plan) if stand_ins else None  # drivers bring their own
    nodes, name = [], "robot_state_publisher"
    if described is not None and name in get_packages_with_prefixes():
        remaps = [*plan.remappings, ("joint_states", arm["state_topic"])]
        own = file.with_name(f"{name}.yaml")  # launch itself would leave a temporary file behind
        own.write_text(yaml.safe_dump({"/**": {"ros__parameters": described}}), encoding="utf-8")
        nodes.append(
            Node(package=name, executable=name, parameters=[str(own)], remappings=remaps, **common)
        )
    if rviz:
        config = file.with_name("session.rviz")
        config.write_text(rviz_file(plan.namespace), encoding="utf-8")
        time = f"use_sim_time:={str(arm.get('use_sim_time', False)).lower()}"
        nodes.append(
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", str(config)],
                ros_arguments=["-p", time],
                remappings=plan.remappings,
                **common,
            )
        )
    return nodes
