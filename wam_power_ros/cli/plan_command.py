# SPDX-License-Identifier: Apache-2.0
"""`wam-power plan`: print the plan that a launch file of launch/ runs."""

from __future__ import annotations

import argparse
import os
import re
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import yaml

from wam_power_ros.cli.launcher import Devices, UsageError, discovery_range, folder_lock
from wam_power_ros.cli.parser import add_command, config_option, session_options
from wam_power_ros.cli.plan import (
    CONTROLLER,
    LEARNER,
    TRACKER,
    Plan,
    Process,
    plan_of,
    ros_arguments,
)
from wam_power_ros.cli.session_options import (
    DEFAULT_TASK,
    SessionOptions,
    chosen,
    learner_parameters,
)
from wam_power_ros.params.resources import robot_description, share
from wam_power_ros.ros.domain import exported, hold, lock_files, shared

NAMESPACE = re.compile(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
STATE_PUBLISHER, RVIZ = "robot_state_publisher", "rviz2"  # packages, and their executables
LAUNCHED = {"sim": "the stand-ins and the nodes", "hardware": "the nodes alone"}  # NAME.launch.py


def add_to(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    text = "print the processes of a session, which the launch files start, as JSON"
    parser = add_command(subparsers, "plan", plan, text)
    parser.set_defaults(demonstrations=0)
    kinds = "; ".join(f"{name}: {what}" for name, what in LAUNCHED.items())
    parser.add_argument("kind", choices=LAUNCHED, help=kinds)
    parser.add_argument("--session", type=Path, help="folder to start or resume; else no learner")
    session_options(parser)
    config_option(parser, "set-up; may be repeated")
    parser.add_argument("--pace", choices=("lockstep", "real_time"), help="of a simulation")
    parser.add_argument("--namespace", default="", help="of the nodes of one arm")
    parser.add_argument("--secure", action="store_true", help="run each node in its enclave")
    parser.add_argument("--rviz", action="store_true", help="start RViz too")
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path(tempfile.gettempdir()) / "wam_power_ros",
        help="for the parameter file if there is no session",
    )


def plan(
    kind: str,
    asked: SessionOptions,
    session: Path | None,
    config: Sequence[str],
    pace: str | None,
    namespace: str,
    secure: bool,
    rviz: bool,
    folder: Path,
) -> None:
    """Print a plan.

    Raises:
        UsageError, ValueError: An option is invalid, contradicts the session or asks for a robot in
            a simulation; or the session or the DDS domain is in use.
    """
    stand_ins = kind == "sim"
    if not (stand_ins or config):
        raise UsageError("config is empty: name the set-up of the arm's driver, such as geodude")
    name = namespace.strip("/")
    if name and not NAMESPACE.fullmatch(name):
        raise UsageError(
            f"namespace {namespace!r} must be names of letters, digits and underscores, "
            "separated by /"
        )
    namespace = f"/{name}" if name else ""
    domain = exported(os.environ)
    devices = Devices(config, stand_ins and (bool(config) or pace == "real_time"))
    if session:
        folder = session.expanduser().resolve()
        seed, task = chosen(folder, asked, devices)
        parameters = devices.parameters(task, seed, folder)
        given = learner_parameters(folder, asked, seed, task)
        if folder.exists():
            with folder_lock(folder):
                pass
    else:
        task = asked.task or DEFAULT_TASK
        parameters = devices.parameters(task, asked.seed or 0)
        given = {"session": "", "task": task}
    parameters = parameters.changed({LEARNER: given})
    locks = []
    if held := hold(domain, namespace):  # else by a parent of this process
        held.close()
        locks = lock_files(domain, namespace)
    made = plan_of(
        folder,
        parameters,
        stand_ins,
        also=(TRACKER, LEARNER) if session else (TRACKER,),
        namespace=namespace,
        secure=secure,
        attended=False,
    )
    environment = shared(domain) | {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": discovery_range(os.environ),
        "ROS_SECURITY_ENABLE": str(secure).lower(),
        "ROS_SECURITY_STRATEGY": "Enforce",
    }
    print(with_displays(made, rviz).json(environment, locks))


def with_displays(plan: Plan, rviz: bool) -> Plan:
    """Add RViz if requested; robot_state_publisher in simulation, where it is installed.

    Raises:
        UsageError: RViz is not installed.
    """
    logs, arm = plan.file.parent, plan.parameters[CONTROLLER]
    processes, files = [], {}
    described = arm_description(plan) if plan.stand_ins else None  # drivers bring their own
    if described is not None and (program := _executable(STATE_PUBLISHER)):
        file = logs / f"{STATE_PUBLISHER}.yaml"
        files[file] = yaml.safe_dump({"/**": {"ros__parameters": described}})
        remapped = ["-r", f"joint_states:={arm['state_topic']}"]
        command = [str(program), *ros_arguments(plan.namespace, file), *remapped]
        processes.append(Process(STATE_PUBLISHER, tuple(command), required=False))
    if rviz:
        if (program := _executable(RVIZ)) is None:
            raise UsageError(f"{RVIZ} is not installed")
        file = logs / "session.rviz"
        files[file] = rviz_file(plan.namespace)
        time = ["-p", f"use_sim_time:={str(arm.get('use_sim_time', False)).lower()}"]
        command = [str(program), "-d", str(file), *ros_arguments(plan.namespace), *time]
        processes.append(Process(RVIZ, tuple(command), required=False))
    return replace(plan, processes=(*plan.processes, *processes), files=files)


def _executable(package: str) -> Path | None:
    """Executable of the same name as its package, in the sourced workspaces."""
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    programs = (Path(prefix) / "lib" / package / package for prefix in prefixes)
    return next(filter(Path.is_file, programs), None)


def arm_description(plan: Plan) -> dict[str, object] | None:
    """Parameters of robot_state_publisher; None without a URDF with the driver's joint names."""
    arm = plan.parameters[CONTROLLER]
    if not arm["urdf"] or arm["joint_names"] != arm["model_joint_names"]:
        return None
    return {
        "robot_description": robot_description(arm["urdf"]),
        "frame_prefix": f"{plan.namespace}/".lstrip("/"),
        "use_sim_time": bool(arm.get("use_sim_time", False)),
    }


def rviz_file(namespace: str) -> str:
    """RViz configuration for the arm in a namespace, such as `/left`; empty for none."""
    from wam_power_ros.ros import interface

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
