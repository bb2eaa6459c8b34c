# SPDX-License-Identifier: Apache-2.0
"""Plan of a session: its processes and their parameters, a value that `cli.launcher` runs."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from wam_power_ros.params import overlay

DOMAIN_FILE = "ros_domain_id"  # in logs/: the DDS domain of a simulation that has its own
SIMULATION, TRACKER, LEARNER = "wam_sim", "pancake_tracker", "learner"
CONTROLLER, RECORDER = "torque_controller", "demonstration_recorder"
DRIVER = "franka_driver"
MODULE = (sys.executable, "-m")


@dataclass(frozen=True)
class Process:
    """A process of a session: its name, which its log has too, and the words of its command."""

    name: str
    command: tuple[str, ...]


@dataclass(frozen=True)
class Plan:
    """What is started for a session, a series of demonstrations or a replay.

    Attributes:
        folder: Folder whose logs/ gets the parameter file and the logs.
        parameters: Parameters by node.
        processes: In the order in which they are started.
        stand_ins: Whether stand-ins take the place of the devices.
        namespace: Namespace of the nodes, such as `/left`; empty for none.
    """

    folder: Path
    parameters: overlay.Setup
    processes: tuple[Process, ...]
    stand_ins: bool
    namespace: str = ""

    @property
    def file(self) -> Path:
        """Parameter file of all nodes."""
        return self.folder / "logs" / "parameters.yaml"

    @property
    def written(self) -> dict[Path, str]:
        """Texts of the files that are written before a process starts, by path."""
        text = overlay.text(self.parameters, self.namespace)
        return {self.file: text, self.file.with_name(DOMAIN_FILE): ""}


def plan_of(
    folder: Path,
    parameters: overlay.Setup,
    stand_ins: bool,
    *,
    also: Sequence[str] = (),
    namespace: str = "",
    secure: bool = False,
) -> Plan:
    """Plan the processes of a session.

    Args:
        folder: Folder of logs/ and, with a learner, of the session.
        parameters: Parameters by node.
        stand_ins: Whether stand-ins take the place of the devices.
        also: Nodes beside controller and recorder; a tracker only if there is a body to track.
        namespace: Namespace of the nodes, such as `/left`; empty for none.
        secure: Whether each node runs in its enclave.
    """
    file = Plan(folder, parameters, (), stand_ins).file
    driver = [DRIVER] if parameters[DRIVER]["address"] else []
    names = [*([SIMULATION] if stand_ins else driver), CONTROLLER, RECORDER]
    names += [name for name in also if name != TRACKER or parameters[TRACKER]["body"]]
    processes = []
    for name in names:
        command = [*MODULE, "wam_power_ros.entry", name, *ros_arguments(namespace, file)]
        command += enclave(name, namespace) if secure else []
        processes.append(Process(name, tuple(command)))
    return Plan(folder, parameters, tuple(processes), stand_ins, namespace)


def overrides(prefix: str, parameters: Mapping[str, object]) -> list[str]:
    """ROS arguments that set parameters; `prefix` names a node, such as `learner:`."""
    given = [f"{prefix}{name}:={json.dumps(value)}" for name, value in parameters.items()]
    return [word for each in given for word in ("-p", each)]


def ros_arguments(namespace: str, file: Path) -> list[str]:
    """ROS arguments of a node; in a namespace each simulation has its own clock."""
    words = ["--ros-args", "--params-file", str(file)]
    if namespace:
        words += ["-r", f"__ns:={namespace}", "-r", f"/clock:={namespace}/clock"]
    return words


def enclave(name: str, namespace: str = "") -> list[str]:
    """ROS arguments that name the enclave of a node."""
    return ["--enclave", f"{namespace}/{name}"]
