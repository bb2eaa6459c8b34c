# SPDX-License-Identifier: Apache-2.0
"""Starts the processes of a plan that `wam-power plan` prints, for the launch files beside it.

It runs in the Python of `ros2`, which may have neither this package nor its dependencies: only the
standard library and `launch` are imported, and the executable of the installation is called.

A launch ends when its learner has ended and the report of the session is written, when another
required process ends, or when a node refuses its parameters; with status 1 unless that process
ended by itself with status 0. Other processes may be restarted. A launch holds its DDS domain.
"""

from __future__ import annotations

import atexit
import fcntl
import json
import os
import shlex
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from launch.actions import DeclareLaunchArgument, ExecuteProcess
    from launch.events.process import ProcessExited
    from launch.launch_description_entity import LaunchDescriptionEntity

    from launch import LaunchContext, LaunchDescription

END_TIMEOUT = "30.0"  # [s] for a node to close its bag or bring the arm to rest
RESPAWN_DELAY = 1.0  # [s], enough for Ctrl-C in the terminal to reach launch too
INTERRUPTED = (130, -signal.SIGINT)  # exit status after Ctrl-C
LOCKS: list[IO[str]] = []  # of DDS domain and session, held until the launch ends
OPTIONS = {  # launch argument, and option of the command -> description
    "namespace": "namespace of the nodes, topics, services and frames of one arm",
    "task": "skill to learn; '': the session's, or flip",
    "session": "folder of a session to start or resume; '': no learner",
    "learner": "learning algorithm; '': the preset's",
    "preset": "settings of the task; '': its first",
    "trials": "budget of rollouts; '': the preset's",
    "minutes": "budget of time; '': none",
    "seed": "seed of a new session and of the simulation; '': the session's, or 0",
}
SWITCHES = {
    "secure": "run each node in its enclave of ROS_SECURITY_KEYSTORE, see SECURITY.md",
    "rviz": "start RViz too",
    "tf": "publish the frames of arm and cameras, for drivers that do not",
}


def description(kind: str, *arguments: DeclareLaunchArgument) -> LaunchDescription:
    """Description of a launch file.

    Args:
        kind: Kind of the plan, `sim` or `hardware`.
        arguments: Arguments of this launch file, besides the common ones.
    """
    from launch.actions import DeclareLaunchArgument, OpaqueFunction
    from launch.substitutions import LaunchConfiguration

    from launch import LaunchDescription

    bags = "bags of a new session; quote paths with spaces"
    options = {"demonstrations": bags, **OPTIONS}
    declared = [
        *arguments,
        *(
            DeclareLaunchArgument(name, default_value="", description=text)
            for name, text in options.items()
        ),
        *(
            DeclareLaunchArgument(
                name, default_value="false", choices=["true", "false"], description=text
            )
            for name, text in SWITCHES.items()
        ),
    ]

    def start(context: LaunchContext) -> list[LaunchDescriptionEntity]:
        values = {each.name: LaunchConfiguration(each.name).perform(context) for each in declared}
        made = plan(kind, values)
        if made is None or not prepare(made):
            return []
        return [_action(process, made) for process in made["processes"]]

    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def plan(kind: str, values: Mapping[str, str]) -> dict[str, Any] | None:
    """Plan of launch arguments; None after Ctrl-C.

    Raises:
        RuntimeError: It is refused, as printed; or the executable is missing.
    """
    folder = tempfile.mkdtemp(prefix="wam_power_ros_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    words = [_executable(), "plan", kind, f"--folder={folder}"]
    words += [f"--{name}={value}" for name in (*OPTIONS, "pace") if (value := values.get(name))]
    words += [f"--config={name}" for name in _words(values, "config")]
    words += [f"--{name}" for name in SWITCHES if values[name] == "true"]
    if bags := _words(values, "demonstrations"):
        words += ["--bags", *bags]
    printed = subprocess.run(words, stdout=subprocess.PIPE, text=True)
    if printed.returncode in INTERRUPTED:
        return None
    if printed.returncode:
        raise RuntimeError("nothing is started, see above")
    return dict(json.loads(printed.stdout))


def _words(values: Mapping[str, str], name: str) -> list[str]:
    """Names or paths in a launch argument, quoted as in a shell."""
    try:
        return shlex.split(values[name])
    except ValueError as error:
        raise ValueError(f"{name} {values[name]!r}: {error}") from None


def _executable() -> str:
    """`wam-power` of the installation of this file, else on PATH."""
    prefix = Path(os.path.abspath(f"{__file__}/../../../.."))
    for program in (prefix / "lib/wam_power_ros/wam-power", prefix / "bin/wam-power"):
        if program.is_file():
            return str(program)
    if found := shutil.which("wam-power"):
        return found
    raise RuntimeError(f"wam-power is neither in {prefix} nor on PATH")


def prepare(plan: Mapping[str, Any]) -> bool:
    """Hold the locks of a plan, write its files and check its domain; return False after Ctrl-C.

    Raises:
        RuntimeError: A simulation would share its domain with a robot.
        BlockingIOError: Another session has begun meanwhile.
    """
    for name, shared in plan["locks"]:
        file = Path(name)
        file.parent.mkdir(parents=True, exist_ok=True)
        LOCKS.append(file.open("r" if file.exists() else "a"))  # it may be another user's
        fcntl.flock(LOCKS[-1], (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    for name, text in plan["files"].items():
        Path(name).write_text(text, encoding="utf-8")
    if not plan["check"]:
        return True
    environment = {**os.environ, **plan["environment"]}
    status = subprocess.run(plan["check"], env=environment).returncode
    if status and status not in INTERRUPTED:
        raise RuntimeError("this domain is not free for a simulation, see above")
    return status == 0


def _action(process: Mapping[str, Any], plan: Mapping[str, Any]) -> ExecuteProcess:
    from launch.actions import ExecuteProcess, Shutdown

    environment = plan["environment"]

    def on_exit(event: ProcessExited, context: LaunchContext) -> list[LaunchDescriptionEntity]:
        if context.is_shutdown:
            return []
        refused = process["respawn"] and event.returncode == plan["refused"]
        if refused or (process["required"] and event.returncode):
            raise RuntimeError(
                f"{event.process_name} ended with status {event.returncode}, see above"
            )
        if not process["required"]:
            return []
        if not process["then"]:
            return [Shutdown(reason=f"{event.process_name} has ended")]
        ended = Shutdown(reason="the session has ended")
        return [
            ExecuteProcess(
                cmd=process["then"],
                name="report",
                output="screen",
                additional_env=environment,
                on_exit=[ended],
            )
        ]

    return ExecuteProcess(
        cmd=process["command"],
        name=process["name"],
        output="screen",
        additional_env=environment,
        sigterm_timeout=END_TIMEOUT,
        sigkill_timeout=END_TIMEOUT,
        on_exit=on_exit,
        respawn=process["respawn"],
        respawn_delay=RESPAWN_DELAY,
    )
