# SPDX-License-Identifier: Apache-2.0
"""Tasks and learners of all installed packages by name, found through entry points."""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from wam_power_ros.tasks.task import Task

TASKS = "wam_power_ros.tasks"
LEARNERS = "wam_power_ros.learners"


def names(group: str) -> list[str]:
    """Names of the entry points of a group, `TASKS` or `LEARNERS`."""
    return sorted({point.name for point in entry_points(group=group)})


def task_type(name: str) -> type[Task]:
    """Class of a task.

    Raises:
        ValueError: No installed package provides a task of this name, or its import fails.
    """
    found: type[Task] = _load(TASKS, name, "task")
    return found


def learner_type(name: str) -> Any:  # noqa: ANN401 - a class, which checks its own settings
    """Class of a learner.

    Raises:
        ValueError: No installed package provides a learner of this name, or its import fails.
    """
    return _load(LEARNERS, name, "learner")


@cache  # reading the entry points of all installed packages takes 15 ms
def _load(group: str, name: str, what: str) -> Any:  # noqa: ANN401
    points: list[EntryPoint] = [p for p in entry_points(group=group) if p.name == name]
    if not points:
        raise ValueError(f"{what} {name!r} is not one of {', '.join(names(group)) or 'none'}")
    try:
        return points[0].load()
    except (ImportError, AttributeError) as error:
        raise ValueError(
            f"{what} {name!r} ({points[0].value}) cannot be loaded: {error}"
        ) from error
