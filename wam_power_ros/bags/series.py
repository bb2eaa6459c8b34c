# SPDX-License-Identifier: Apache-2.0
"""Series of demonstrations: demonstrations.json, a list of bags, beside the folder of the bags.

The list is updated after every take, and when a bag is renamed or discarded. Discarding moves a bag
to `.trash` beside it, from where it can be moved back.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

from wam_power_ros import durable_files, plain_json
from wam_power_ros.bags import layout

FILE = "demonstrations.json"
TRASH = ".trash"


def read(file: Path) -> list[Path]:
    """Bags of a series, in order; empty when there is no list yet.

    Raises:
        ValueError: The file is not a list of paths.
    """
    if not file.exists():
        return []
    found = plain_json.read(file)
    if not isinstance(found, list) or not all(isinstance(bag, str) for bag in found):
        raise ValueError(f"{file} must be a list of paths of bags")
    return [Path(bag) for bag in found]


def write(file: Path, bags: Sequence[Path]) -> None:
    """Replace the list of a series atomically."""
    durable_files.replace(file, json.dumps([str(bag) for bag in bags]) + "\n")


def discard(bag: Path) -> Path:
    """Move a bag to the trash beside it and remove it from its series.

    Returns:
        New path of the bag.

    Raises:
        ValueError: The path is not a bag, closed or not.
    """
    folder = bag if bag.is_dir() else layout.unfinished(bag)
    if bag.name == "" or not folder.is_dir() or not _is_bag(bag, folder):
        raise ValueError(f"{bag} is not a bag")
    trash = folder.parent / TRASH
    trash.mkdir(exist_ok=True)
    old = folder.parent.resolve() / folder.name
    to = layout.free_path(trash, folder.name)
    return _move(folder, to, lambda bags: [b for b in bags if b.resolve() != old])


def rename(bag: Path, name: str) -> Path:
    """Rename a bag in its folder, and in its series.

    Returns:
        New path of the bag.

    Raises:
        ValueError: The path is not a bag, or the new name is invalid or in use.
    """
    if not _is_bag(bag, bag):
        raise ValueError(f"{bag} is not a bag")
    invalid = not name or Path(name).name != name or name.startswith(".")
    if invalid or not name.isprintable() or name.endswith(layout.UNFINISHED):
        raise ValueError(f"{name!r} is not a valid name of a bag")
    to = bag.with_name(name)
    if to.exists() or layout.unfinished(to).exists():
        raise ValueError(f"{to} exists already")
    old, new = bag.resolve(), to.resolve()
    return _move(bag, to, lambda bags: [new if b.resolve() == old else b for b in bags])


def _is_bag(bag: Path, folder: Path) -> bool:
    """Whether the folder of a bag, closed or not, contains one."""
    return (
        (folder / "metadata.yaml").is_file()
        or any(folder.glob("*.mcap"))
        or (folder / bag.name).is_dir()
    )


def _move(bag: Path, to: Path, change: Callable[[Sequence[Path]], list[Path]]) -> Path:
    """Move a bag, then change the series that contains it."""
    file = bag.parent.resolve().parent / FILE
    listed = read(file)
    bag.rename(to)
    if (changed := change(listed)) != listed:
        write(file, changed)
    return to
