# SPDX-License-Identifier: Apache-2.0
"""The nodes of one set-up, each started as a process of its own."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import FrameType

from wam_power_ros.cli.processes import Processes, Running, private_domain
from wam_power_ros.params import overlay

DOMAIN = "ros_domain_id"  # file in a session's logs/: where its simulated nodes talk


class UsageError(Exception):
    """What was asked for cannot be done; the message says what can."""


@dataclass(frozen=True)
class Bench:
    """The nodes of one set-up that run."""

    processes: Processes
    setup: overlay.Setup
    file: Path  # that holds it

    def start(self, node: str, **parameters: object) -> Running:
        """Start a node with its part of the set-up, and some parameters over it."""
        command = [sys.executable, "-m", "wam_power_ros.cli", "run", node, "--ros-args"]
        command += ["--params-file", str(self.file)]
        command += enclave(node)
        for name, value in parameters.items():
            command += ["-p", f"{node}:{name}:={value}"]
        return self.processes.start(node, command)


@contextmanager
def open_bench(
    options: argparse.Namespace, folder: Path, seed: int, changes: overlay.Setup | None = None
) -> Iterator[Bench]:
    """Controller, recorder into `folder`, and stand-ins unless there is a real arm."""
    setup = overlay.setup(options.config, options.simulate)
    for node, values in (changes or {}).items():
        setup[node] |= values
    file = folder / "logs" / "parameters.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(overlay.text(setup))
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **os.environ}
    with ExitStack() as leave:
        if simulated(options):
            environment["ROS_DOMAIN_ID"] = str(leave.enter_context(private_domain()))
            (folder / "logs" / DOMAIN).write_text(environment["ROS_DOMAIN_ID"] + "\n")
        else:
            (folder / "logs" / DOMAIN).unlink(missing_ok=True)
            _consent()
        processes = leave.enter_context(Processes(folder / "logs", environment))
        bench = Bench(processes, setup, file)
        if simulated(options):
            bench.start("wam_sim", seed=seed)
        bench.start("torque_controller")
        bench.start("demonstration_recorder", directory=folder / "bags")
        yield bench


def enclave(name: str) -> list[str]:
    """Options that put a node into its enclave, where security is on."""
    secure = os.environ.get("ROS_SECURITY_ENABLE") == "true"
    return ["--enclave", f"/{name}"] if secure else []


def simulated(options: argparse.Namespace) -> bool:
    """Whether stand-ins take the place of the devices."""
    return options.simulate or not options.config


def chosen(options: argparse.Namespace) -> list[str]:
    """The options that choose the same set-up again."""
    again = [word for name in options.config for word in ("--config", name)]
    return [*again, "--simulate"] if options.simulate else again


def _consent() -> None:
    """Nobody steps through a life cycle here: the controller holds the arm once states come."""
    print(
        "The controller takes hold of the arm where it is as soon as its driver sends states. "
        "Hand on the pendant, then press Enter: ",
        end="",
        file=sys.stderr,
        flush=True,
    )
    if not sys.stdin.readline():
        raise UsageError("nobody is at the keyboard: standard input is closed")


def now() -> str:
    """As the name of a folder."""
    return datetime.now().strftime("%Y-%m-%d-%H%M%S")


def shown(path: Path) -> Path:
    """The shorter way to say a path."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def interrupt(number: int, frame: FrameType | None) -> None:
    """Handler of a signal that is to end things as Ctrl-C does."""
    raise KeyboardInterrupt
