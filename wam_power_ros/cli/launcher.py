# SPDX-License-Identifier: Apache-2.0
"""Launcher: starts the nodes of one set-up, each as a process of its own."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import FrameType

from wam_power_ros.cli.processes import Processes, Running, private_domain
from wam_power_ros.console.prompt import ask
from wam_power_ros.params import overlay

DOMAIN = "ros_domain_id"  # file in a session's logs/ that holds the domain of its simulated nodes


class UsageError(Exception):
    """The request cannot be carried out; the message says what can."""


@dataclass(frozen=True)
class Launcher:
    """Running nodes of one set-up.

    Attributes:
        processes: Processes of the nodes.
        setup: Parameters by node.
        file: Parameter file that holds the set-up.
    """

    processes: Processes
    setup: overlay.Setup
    file: Path

    def node(self, name: str, **parameters: object) -> Running:
        """Start a node with its part of the set-up; `parameters` override it."""
        command = [sys.executable, "-m", "wam_power_ros.cli", "run", name, "--ros-args"]
        command += ["--params-file", str(self.file), *_enclave(name)]
        for key, value in parameters.items():
            command += ["-p", f"{name}:{key}:={json.dumps(value)}"]
        return self.processes.start(name, command)

    def script(self, name: str, **parameters: object) -> Running:
        """Start a script of `console`, which uses this terminal."""
        command = [sys.executable, "-m", f"wam_power_ros.console.{name}", "--ros-args"]
        command += _enclave("operator")
        for key, value in parameters.items():
            command += ["-p", f"{key}:={json.dumps(value)}"]
        return self.processes.start(name, command, talks=True)


@contextmanager
def launch(
    options: argparse.Namespace,
    folder: Path,
    seed: int,
    task: str = "",
    changes: overlay.Setup | None = None,
) -> Iterator[Launcher]:
    """Start controller and recorder, and the stand-ins unless there is a real arm.

    Args:
        options: Parsed options; `config` and `simulate` choose the set-up.
        folder: Folder for bags and logs.
        seed: Seed of the stand-in.
        task: Name of the task whose set-up lies under the others; empty for none.
        changes: Parameters by node that override the set-up.
    """
    setup = overlay.setup(options.config, options.simulate, task_setup(task) if task else "")
    for node, values in (changes or {}).items():
        setup[node] |= values
    file = folder / "logs" / "parameters.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(overlay.text(setup))
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **os.environ}
    domain = folder / "logs" / DOMAIN
    with ExitStack() as stack:
        if simulated(options):
            environment["ROS_DOMAIN_ID"] = str(stack.enter_context(private_domain()))
            domain.write_text(environment["ROS_DOMAIN_ID"] + "\n")
        else:
            domain.unlink(missing_ok=True)
            _confirm_activation()
        processes = stack.enter_context(Processes(folder / "logs", environment))
        launcher = Launcher(processes, setup, file)
        if simulated(options):
            launcher.node("wam_sim", seed=seed)
        launcher.node("torque_controller")
        launcher.node("demonstration_recorder", directory=str(folder / "bags"))
        yield launcher


def task_setup(task: str) -> str:
    """Set-up of a task: its name for config/TASK.yaml, or the file TASK.yaml beside its module.

    Raises:
        ValueError: When there is no such task; lists the known ones.
    """
    from wam_power_ros.practice import plugins

    module = sys.modules[plugins.task_type(task).__module__]
    beside = Path(module.__file__ or "").with_name(f"{task}.yaml")
    return str(beside) if beside.is_file() else task


def _enclave(name: str) -> list[str]:
    """ROS arguments that name the enclave of a node, where security is enabled."""
    secure = os.environ.get("ROS_SECURITY_ENABLE") == "true"
    return ["--enclave", f"/{name}"] if secure else []


def simulated(options: argparse.Namespace) -> bool:
    """Whether stand-ins take the place of the devices."""
    return options.simulate or not options.config


def setup_options(options: argparse.Namespace) -> list[str]:
    """Command-line words that choose the same set-up again."""
    words = [word for name in options.config for word in ("--config", name)]
    return [*words, "--simulate"] if options.simulate else words


def _confirm_activation() -> None:
    """Ask before the controller starts: it activates by itself, without lifecycle commands."""
    if not ask(
        "The controller holds the arm in its present posture as soon as the driver sends states. "
        "Keep a hand on the pendant, then press Enter: "
    ):
        raise UsageError("no answer: standard input is closed")


def now() -> str:
    """Present time as the name of a folder."""
    return datetime.now().strftime("%Y-%m-%d-%H%M%S")


def short_path(path: Path) -> Path:
    """Path relative to the working directory where it lies below it."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def interrupt(number: int, frame: FrameType | None) -> None:
    """Signal handler that acts as Ctrl-C does."""
    raise KeyboardInterrupt
