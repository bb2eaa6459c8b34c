# SPDX-License-Identifier: Apache-2.0
"""Series of demonstrations: a list of bags, demonstrations.json beside the folder they are in.

The list is written again after every take. A bag that is renamed or discarded is renamed or left
out there too; discarding moves it to `.trash` beside it, from where it can be moved back.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

from wam_power_ros import durable_files
from wam_power_ros.bags import layout

FILE = "demonstrations.json"
TRASH = ".trash"


def read(file: Path) -> list[Path]:
    """Bags of a series, in order; none when there is no list yet.

    Raises:
        ValueError: It is no list of paths.
    """
    if not file.exists():
        return []
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{file} is not JSON: {error}") from None
    if not isinstance(found, list) or not all(isinstance(bag, str) for bag in found):
        raise ValueError(f"{file} must be a list of paths of bags")
    return [Path(bag) for bag in found]


def write(file: Path, bags: Sequence[Path]) -> None:
    """Replace the list of a series, atomically."""
    durable_files.replace(file, json.dumps([str(bag) for bag in bags]) + "\n")


def discard(bag: Path) -> Path:
    """Move a bag to the trash beside it and take it off its series.

    Returns:
        Its new path.

    Raises:
        ValueError: There is no bag, closed or not, of this path.
    """
    held = bag if bag.is_dir() else layout.unfinished(bag)
    if bag.name == "" or not held.is_dir() or not _is_bag(bag, held):
        raise ValueError(f"{bag} is not a bag")
    trash = held.parent / TRASH
    trash.mkdir(exist_ok=True)
    return _moved(held, layout.free_path(trash, held.name), lambda bags: _without(bags, held))


def rename(bag: Path, name: str) -> Path:
    """Give a bag another name in its folder, and in its series.

    Returns:
        Its new path.

    Raises:
        ValueError: There is no bag of this path, or the name is no name of a folder or taken.
    """
    if not _is_bag(bag, bag):
        raise ValueError(f"{bag} is not a bag")
    odd = not name or Path(name).name != name or name.startswith(".")
    if odd or name.endswith(layout.UNFINISHED):
        raise ValueError(f"{name!r} is no name of a bag")
    to = bag.with_name(name)
    if to.exists() or layout.unfinished(to).exists():
        raise ValueError(f"{to} is there already")
    old, new = bag.resolve(), to.resolve()
    return _moved(bag, to, lambda bags: [new if b.resolve() == old else b for b in bags])


def _is_bag(bag: Path, held: Path) -> bool:
    """Whether a folder is a bag, or one that was not closed."""
    return (
        (held / "metadata.yaml").is_file() or any(held.glob("*.mcap")) or (held / bag.name).is_dir()
    )


def _without(bags: Sequence[Path], held: Path) -> list[Path]:
    gone = held.parent.resolve() / held.name
    return [bag for bag in bags if bag.resolve() != gone]


def _moved(bag: Path, to: Path, change: Callable[[Sequence[Path]], list[Path]]) -> Path:
    """Move a bag, then change the series that it belongs to."""
    file = bag.parent.resolve().parent / FILE
    listed = read(file)
    bag.rename(to)
    if (changed := change(listed)) != listed:
        write(file, changed)
    return to
