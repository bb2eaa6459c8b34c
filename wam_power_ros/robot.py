# SPDX-License-Identifier: Apache-2.0
"""An arm as a Python object, of running nodes (`connect`) or of stand-ins (`simulated`)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from wam_power_ros.cli import launcher
from wam_power_ros.cli.plan import TRACKER, Plan
from wam_power_ros.client.robot import Robot, connect, connected

__all__ = ["Robot", "connect", "simulated"]


@contextmanager
def simulated(folder: Path | str, task: str, seed: int = 0) -> Iterator[Robot]:
    """Start an arm's nodes and stand-ins, in a DDS domain of their own.

    Raises:
        UsageError: Another launcher uses the folder.
        ValueError: There is no such task.
    """
    folder = Path(folder).resolve()
    parameters = launcher.Devices().parameters(task, seed, folder)
    plan = Plan(folder, parameters, stand_ins=True, also=(TRACKER,))
    with (
        launcher.launch(plan),
        connected(plan.parameters, launcher.session_domain(folder), on_loopback=True) as arm,
    ):
        yield arm
