# SPDX-License-Identifier: Apache-2.0
"""Plan of a session: its nodes and their parameters, a value that `cli.launcher` runs."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

from wam_power_ros.params import overlay

DOMAIN_FILE = "ros_domain_id"  # in logs/: the DDS domain of a simulation that has its own
SIMULATION, TRACKER, LEARNER = "wam_sim", "pancake_tracker", "learner"
CONTROLLER, RECORDER = "torque_controller", "demonstration_recorder"
DRIVER = "franka_driver"


@dataclass(frozen=True)
class Plan:
    """What is started for a session, a series of demonstrations or a replay."""

    folder: Path  # whose logs/ gets the parameter file and the logs
    parameters: overlay.Setup
    stand_ins: bool  # whether they take the place of the devices
    also: tuple[str, ...] = ()  # beside controller and recorder; a tracker if there is a body

    @property
    def nodes(self) -> list[str]:
        """Nodes in the order in which they are started."""
        tracked = self.parameters[TRACKER]["body"]
        also = [name for name in self.also if name != TRACKER or tracked]
        driver = [DRIVER] if self.parameters[DRIVER]["address"] else []
        return [*([SIMULATION] if self.stand_ins else driver), CONTROLLER, RECORDER, *also]

    @property
    def file(self) -> Path:
        """Parameter file of all nodes."""
        return self.folder / "logs" / "parameters.yaml"

    @property
    def written(self) -> dict[Path, str]:
        """Texts of the files that are written before a process starts, by path."""
        return {self.file: overlay.text(self.parameters), self.file.with_name(DOMAIN_FILE): ""}

    def command(self, name: str, secure: bool, **parameters: object) -> list[str]:
        """Command of a node, in its enclave if `secure`; `parameters` override its own."""
        words = [sys.executable, "-m", "wam_power_ros.entry", name, "--ros-args"]
        words += ["--params-file", str(self.file), *["--enclave", f"/{name}"] * secure]
        given = [f"{name}:{key}:={json.dumps(value)}" for key, value in parameters.items()]
        return [*words, *(word for each in given for word in ("-p", each))]
