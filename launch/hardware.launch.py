# SPDX-License-Identifier: Apache-2.0
"""Start the nodes on the real arm, without stand-ins. Start the drivers of arm and cameras first.

    ros2 launch wam_power_ros hardware.launch.py config:="geodude natnet_ros2"

A person activates the controller: `ros2 lifecycle set /torque_controller configure`, then
`activate`; a learner, started with `session`, waits for it. The launch ends when the learner or the
controller ends, or when a node refuses its parameters; with status 1 if that node failed.
"""

from __future__ import annotations

import shlex
from pathlib import Path

import yaml
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

CONFIG = Path(__file__).parents[1] / "config"
RESPAWNED = ("demonstration_recorder", "pancake_tracker")  # each loses one rollout at most
REFUSED = 2  # exit status of a node that refuses its parameters, as it would again
ARGUMENTS = {
    "config": ("", "set-ups, config/NAME.yaml or paths of your own; later ones override"),
    "task": ("flip", "skill to learn; config/TASK.yaml is applied before the set-ups"),
    "session": ("", "folder of a session to start or resume; '': no learner"),
    "demonstrations": ("", "bags of a new session; quote paths with spaces"),
    "learner": ("", "learning algorithm; '': the preset's"),
    "preset": ("", "settings of the task; '': its first"),
    "trials": ("0", "budget of rollouts; 0: the preset's"),
    "minutes": ("0", "budget of time; 0: none"),
    "seed": ("0", "of exploration and simulation; for a resumed session the same again"),
    "namespace": ("", "of the nodes, topics and services of one arm"),
    "simulate": ("", "pace of a simulation instead of the arm: lockstep or real_time"),
}


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and nodes."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes of an arm."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    pace, session = given["simulate"], given["session"]
    if not (pace or given["config"].strip()):
        raise RuntimeError("config is empty: name the set-up of the arm's driver, such as geodude")
    rules = {"": [], "real_time": ["simulation"], "lockstep": ["simulation", "lockstep"]}[pace]
    files = parameter_files([*shlex.split(given["config"]), *rules], given["task"])
    own = {"torque_controller": {}, "demonstration_recorder": {}}
    if has_body(files):
        own["pancake_tracker"] = {}
    if pace:
        own["wam_sim"] = {"seed": int(given["seed"])}
    if session:
        folder = Path(session).expanduser().absolute()
        own["demonstration_recorder"] = {"directory": str(folder / "bags")}
        own["learner"] = {
            "session": str(folder),
            "task": given["task"],
            "demonstrations": shlex.split(given["demonstrations"]) or [""],
            **{name: given[name] for name in ("learner", "preset")},
            **{name: int(given[name]) for name in ("trials", "minutes", "seed")},
        }
    inside = f"/{given['namespace'].strip('/')}".rstrip("/")
    return [
        Node(
            package="wam_power_ros",
            executable=name,
            namespace=inside or None,
            parameters=[*files, values] if values else files,
            remappings=[("/clock", f"{inside}/clock")] if inside else None,
            ros_arguments=["--enclave", f"{inside}/{name}"],
            output="screen",
            respawn=name in RESPAWNED,
            respawn_delay=1.0,
            sigterm_timeout="30.0",  # [s] to close a bag or bring the arm to rest
            sigkill_timeout="30.0",
            on_exit=refusal if name in RESPAWNED else end,
        )
        for name, values in own.items()
    ]


def parameter_files(names: list[str], task: str) -> list[str]:
    """Parameter files of the task and of set-ups; what an arm needs for it is in NAME.TASK.yaml."""
    files = [CONFIG / f"{task}.yaml"]
    for name in names:
        file = CONFIG / f"{name}.yaml"
        file = file if file.is_file() else Path(name).expanduser()
        if not file.is_file():
            raise RuntimeError(f"no set-up {name!r}: neither in {CONFIG} nor the path of a file")
        files += [file, file.with_suffix(f".{task}.yaml")]
    return [str(file) for file in files if file.is_file()]


def has_body(files: list[str]) -> bool:
    """Return whether the task has a tracked body."""
    body = "pancake"
    for file in files:
        for name, section in (yaml.safe_load(Path(file).read_text()) or {}).items():
            if name.endswith(("pancake_tracker", "**")):
                body = section["ros__parameters"].get("body", body)
    return bool(body)


def end(event: ProcessExited, context: LaunchContext) -> Shutdown:
    """End the launch with a node; with status 1 if that failed."""
    if event.returncode and not context.is_shutdown:
        raise RuntimeError(f"{event.process_name} ended with status {event.returncode}, see above")
    return Shutdown(reason=f"{event.process_name} has ended")


def refusal(event: ProcessExited, context: LaunchContext) -> Shutdown | None:
    """End the launch if a node would refuse its parameters again."""
    return end(event, context) if event.returncode == REFUSED else None
