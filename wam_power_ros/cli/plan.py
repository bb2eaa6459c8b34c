# SPDX-License-Identifier: Apache-2.0
"""Plan of a session: its processes and their parameters, what may end, and what is restarted.

A plan is a value. `cli.launcher` runs it in this terminal; the launch files run it from the JSON
that `wam-power plan` prints.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from wam_power_ros.entry import REFUSED
from wam_power_ros.params import overlay

DOMAIN_FILE = "ros_domain_id"  # in logs/: the DDS domain of a simulation that has its own
SIMULATION, TRACKER, LEARNER = "wam_sim", "pancake_tracker", "learner"
CONTROLLER, RECORDER = "torque_controller", "demonstration_recorder"
RESTARTED = (RECORDER, TRACKER)  # each loses one rollout at most
MODULE = (sys.executable, "-m")


@dataclass(frozen=True)
class Process:
    """A process of a session.

    Attributes:
        name: Name of the process, which its log has too.
        command: Words of its command.
        required: Whether its end, with any status, ends the session.
        respawn: Whether it is started again when it ends, unless it refuses its parameters.
        then: Words of the command that ends the session after its end with status 0; none if empty.
    """

    name: str
    command: tuple[str, ...]
    required: bool = True
    respawn: bool = False
    then: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """What is started for a session, a series of demonstrations or a replay.

    Attributes:
        folder: Folder whose logs/ gets the parameter file and the logs.
        parameters: Parameters by node.
        processes: In the order in which they are started.
        stand_ins: Whether stand-ins take the place of the devices.
        namespace: Namespace of the nodes, such as `/left`; empty for none.
        files: Texts of further files that they read, by path.
    """

    folder: Path
    parameters: overlay.Setup
    processes: tuple[Process, ...]
    stand_ins: bool
    namespace: str = ""
    files: Mapping[Path, str] = field(default_factory=dict)

    @property
    def file(self) -> Path:
        """Parameter file of all nodes."""
        return self.folder / "logs" / "parameters.yaml"

    @property
    def lock(self) -> Path:
        """File that is locked while the plan is run."""
        return self.folder / "logs" / ".lock"

    @property
    def written(self) -> dict[Path, str]:
        """Texts of the files that are written before a process starts, by path."""
        text = overlay.text(self.parameters, self.namespace)
        return {self.file: text, self.file.with_name(DOMAIN_FILE): "", **self.files}

    def json(
        self, environment: Mapping[str, str], domain_locks: Sequence[tuple[Path, bool]]
    ) -> str:
        """Write the plan as a launch file reads it.

        Args:
            environment: Environment variables of the processes, beside the inherited ones.
            domain_locks: Files that hold the DDS domain, and whether others may lock each as well.
        """
        check = [*MODULE, "hardware_sim.driver_watch", *ros_arguments(self.namespace, self.file)]
        value = {
            "environment": dict(environment),
            "locks": [[str(file), shared] for file, shared in (*domain_locks, (self.lock, False))],
            "files": {str(file): text for file, text in self.written.items()},
            "check": check if self.stand_ins else [],
            "refused": REFUSED,
            "processes": [vars(process) for process in self.processes],
        }
        return json.dumps(value, indent=2)


def plan_of(
    folder: Path,
    parameters: overlay.Setup,
    stand_ins: bool,
    *,
    also: Sequence[str] = (),
    namespace: str = "",
    secure: bool = False,
    attended: bool = True,
) -> Plan:
    """Plan the processes of a session.

    Args:
        folder: Folder of logs/ and, with a learner, of the session.
        parameters: Parameters by node.
        stand_ins: Whether stand-ins take the place of the devices.
        also: Nodes beside controller and recorder; a tracker only if there is a body to track.
        namespace: Namespace of the nodes, such as `/left`; empty for none.
        secure: Whether each node runs in its enclave.
        attended: Whether a person at the terminal resumes a session after the end of any process.
            Otherwise recorder and tracker are restarted.
    """
    file = Plan(folder, parameters, (), stand_ins).file
    names = [*[SIMULATION] * stand_ins, CONTROLLER, RECORDER]
    names += [name for name in also if name != TRACKER or parameters[TRACKER]["body"]]
    processes = []
    for name in names:
        command = [*MODULE, "wam_power_ros.entry", name, *ros_arguments(namespace, file)]
        command += enclave(name, namespace) if secure else []
        respawn = name in RESTARTED and not attended
        then = (*MODULE, "wam_power_ros.cli", "report", str(folder)) if name == LEARNER else ()
        processes.append(Process(name, tuple(command), not respawn, respawn, then))
    return Plan(folder, parameters, tuple(processes), stand_ins, namespace)


def script(name: str, secure: bool = False, **parameters: object) -> list[str]:
    """Command of a script of `console`, which uses the terminal and ends by itself."""
    command = [*MODULE, f"wam_power_ros.console.{name}", "--ros-args"]
    command += enclave("operator") if secure else []
    return command + overrides("", parameters)


def overrides(prefix: str, parameters: Mapping[str, object]) -> list[str]:
    """ROS arguments that set parameters; `prefix` names a node, such as `learner:`."""
    given = [f"{prefix}{name}:={json.dumps(value)}" for name, value in parameters.items()]
    return [word for each in given for word in ("-p", each)]


def ros_arguments(namespace: str, *files: Path) -> list[str]:
    """ROS arguments of a node; in a namespace each simulation has its own clock."""
    words = ["--ros-args"]
    for file in files:
        words += ["--params-file", str(file)]
    if namespace:
        words += ["-r", f"__ns:={namespace}", "-r", f"/clock:={namespace}/clock"]
    return words


def enclave(name: str, namespace: str = "") -> list[str]:
    """ROS arguments that name the enclave of a node."""
    return ["--enclave", f"{namespace}/{name}"]
