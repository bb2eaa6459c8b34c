# SPDX-License-Identifier: Apache-2.0
"""`wam-power plan`: print the plan that a launch file of launch/ runs."""

from __future__ import annotations

import argparse
import os
import re
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import yaml

from wam_power_ros.cli import layouts
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
    with_origin,
)
from wam_power_ros.params.body_tracker_params import BodyTrackerParams
from wam_power_ros.params.resources import robot_description
from wam_power_ros.ros.domain import exported, hold, lock_files, shared
from wam_power_ros.tracking.tracker import base_in_world

NAMESPACE = re.compile(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
STATE_PUBLISHER, RVIZ = "robot_state_publisher", "rviz2"  # packages, and their executables
STATIC_PUBLISHER = "static_transform_publisher"  # of tf2_ros
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")  # its options
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
    frames = "publish the frames of arm and cameras, for drivers that do not"
    parser.add_argument("--tf", action="store_true", help=frames)
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
    tf: bool,
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
    namespace = checked_namespace(namespace)
    domain = exported(os.environ)
    devices = Devices(config, stand_ins and (bool(config) or pace == "real_time"))
    if session:
        folder = session.expanduser().resolve()
        asked = with_origin(asked, devices)
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
    print(with_displays(made, rviz, tf).json(environment, locks))


def checked_namespace(text: str) -> str:
    """Namespace of the nodes of one arm, such as `/left`; empty for none.

    Raises:
        UsageError: It is not names, separated by slashes.
    """
    name = text.strip("/")
    if name and not NAMESPACE.fullmatch(name):
        raise UsageError(
            f"namespace {text!r} must be names of letters, digits and underscores, separated by /"
        )
    return f"/{name}" if name else ""


def with_displays(plan: Plan, rviz: bool, tf: bool) -> Plan:
    """Add RViz if requested, and the publishers of the frames of arm and motion capture.

    In simulation these are started where they are installed; on hardware if requested, because most
    drivers have their own and two trees of the same frames contradict each other.

    Raises:
        UsageError: What is requested is not installed, or the arm has no URDF with its joint names.
    """
    logs, arm = plan.file.parent, plan.parameters[CONTROLLER]
    processes, files = [], {}
    described = arm_description(plan) if plan.stand_ins or tf else None
    program = _executable(STATE_PUBLISHER, required=tf)
    if described is not None and program is not None:
        file = logs / f"{STATE_PUBLISHER}.yaml"
        files[file] = yaml.safe_dump({"/**": {"ros__parameters": described}})
        remapped = ["-r", f"joint_states:={arm['state_topic']}"]
        command = [str(program), *ros_arguments(plan.namespace, file), *remapped]
        processes.append(Process(STATE_PUBLISHER, tuple(command), required=False))
    elif tf:
        raise UsageError(f"{STATE_PUBLISHER} needs a URDF with the joint names of the driver")
    elif plan.stand_ins and rviz:
        why = "is not installed" if described else "has no URDF with the joint names of the driver"
        print(f"RViz shows no model of the arm: {STATE_PUBLISHER} {why}", file=sys.stderr)
    tracker, program = plan.parameters[TRACKER], _executable(STATIC_PUBLISHER, "tf2_ros", tf)
    if (plan.stand_ins or tf) and tracker["body"] and program is not None:
        pose = base_in_world(BodyTrackerParams.of_setup(plan.parameters))
        words = [f"--{name}={value}" for name, value in zip(POSE, pose.tolist(), strict=True)]
        words += [f"--frame-id={plan.parameters['optitrack_sim']['frame']}"]
        words += [f"--child-frame-id={plan.namespace}/{arm['base_frame']}".replace("=/", "=")]
        command = [str(program), *words, *ros_arguments(plan.namespace)]
        processes.append(Process(STATIC_PUBLISHER, tuple(command), required=False))
    if rviz:
        program = _executable(RVIZ, required=True)
        file = logs / "session.rviz"
        files[file] = layouts.rviz(plan.parameters, plan.namespace)
        time = ["-p", f"use_sim_time:={str(arm.get('use_sim_time', False)).lower()}"]
        command = [str(program), "-d", str(file), *ros_arguments(plan.namespace), *time]
        processes.append(Process(RVIZ, tuple(command), required=False))
    return replace(plan, processes=(*plan.processes, *processes), files=files)


def _executable(name: str, package: str = "", required: bool = False) -> Path | None:
    """Executable of a package, by default of the same name, in the sourced workspaces.

    Raises:
        UsageError: It is required and not installed.
    """
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    programs = (Path(prefix) / "lib" / (package or name) / name for prefix in prefixes)
    found = next(filter(Path.is_file, programs), None)
    if required and found is None:
        raise UsageError(f"{name} is not installed")
    return found


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
