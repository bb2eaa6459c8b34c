# SPDX-License-Identifier: Apache-2.0
"""Tasks, learners and scenes of all installed packages by name, and the set-ups of the tasks."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable
from functools import cache
from importlib import import_module, util
from importlib.machinery import SourceFileLoader
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wam_power_ros.tasks.task import Task


def names(kind: str) -> list[str]:
    """Names of all that is installed of a kind: "task", "learner" or "scene"."""
    return sorted({point.name for point in entry_points(group=f"wam_power_ros.{kind}s")})


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a question that suggests the nearest known word; empty if none is near."""
    near = difflib.get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


@cache  # reading the entry points of all installed packages takes 15 ms
def find(kind: str, name: str) -> Any:  # noqa: ANN401 - a class
    """Class of a "task", "learner" or "scene".

    A learner may also be named by its class, "package.module:Class", if this program has imported
    the module. Nothing is imported by such a name: a session that was handed on states one, too.

    Raises:
        ValueError: No installed package declares the name, two do, or it cannot be imported; or no
            such class of a learner has been.
    """
    module, _, attribute = name.partition(":")
    if attribute and kind == "learner":
        own = getattr(sys.modules.get(module), attribute, None)
        if isinstance(own, type) and hasattr(own, "Settings") and hasattr(own, "tell"):
            return own
        raise ValueError(
            f"learner {name!r} is no class of a learner that this program has imported"
        )
    points = [p for p in entry_points(group=f"wam_power_ros.{kind}s") if p.name == name]
    declared = " and ".join(f"{p.value} of {p.dist.name if p.dist else '?'}" for p in points)
    if not points:
        known = ", ".join(names(kind)) or "none: install wam_power_ros again (make venv)"
        raise ValueError(f"{kind} {name!r} is not one of {known}{did_you_mean(name, names(kind))}")
    if len(points) > 1:
        raise ValueError(f"{kind} {name!r} is declared twice, {declared}: rename or uninstall one")
    try:
        return points[0].load()
    except Exception as error:  # whatever the module of another package raises
        raise ValueError(f"{kind} {name!r} ({declared}) cannot be loaded: {error}") from error


def import_task(name: str) -> str:
    """Import the module of a task "package.module:Class" or "file.py:Class" that a person names.

    Returns the name by which `task_type` finds it from now on, with the whole path of a file.

    Raises:
        ValueError: The module cannot be imported.
    """
    module, colon, own = name.partition(":")
    if not colon:
        return name
    try:
        if module.endswith(".py"):
            module = str(Path(module).resolve())
            if module not in sys.modules:
                loader = SourceFileLoader(module, module)
                made = util.module_from_spec(util.spec_from_loader(module, loader))
                sys.modules[module] = made
                loader.exec_module(made)
        import_module(module)
    except Exception as error:  # whatever the module raises
        sys.modules.pop(module, None)
        raise ValueError(f"task {name!r} cannot be imported: {error}") from error
    return f"{module}:{own}"


def task_type(name: str) -> type[Task]:
    """Class of a task; raises a ValueError as `find`, or if it is no task of this name.

    "package.module:Class" is one that this program has imported, such as a script's own.
    """
    from wam_power_ros.tasks.task import Task

    module, colon, own = name.partition(":")
    found = getattr(sys.modules.get(module), own, None) if colon else find("task", name)
    if not (isinstance(found, type) and issubclass(found, Task) and (colon or found.name == name)):
        raise ValueError(f"task {name!r}: {found} is not an imported subclass of Task so named")
    return found


def task_setup(name: str, own: Path) -> Path:
    """Set-up of a task: the file NAME.yaml beside its module, or in `own` for one of this package.

    A task that brings none has that of the task from which it is derived.

    Raises:
        ValueError: As `task_type`, or there is no such file.
    """
    looked = []
    for kind in [each for each in task_type(name).__mro__ if "name" in vars(each)]:
        beside = Path(str(sys.modules[kind.__module__].__file__)).parent
        folder = own if kind.__module__.startswith(f"{__package__}.") else beside
        looked.append(str(file := folder / f"{vars(kind)['name']}.yaml"))
        if file.is_file():
            return file
    where = f"there is no {' and no '.join(looked)}"
    raise ValueError(f"{where}: task {name!r} needs it, packed as package-data of its package")
