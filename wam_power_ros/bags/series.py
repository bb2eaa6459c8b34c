# SPDX-License-Identifier: Apache-2.0
"""Series of demonstrations: demonstrations.json, a list of bags, beside the folder of the bags.

The list is updated after every take, and when a bag is discarded, which moves it to `.trash` beside
it, from where it can be moved back.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
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

    Raises:
        ValueError: The path is not a bag, closed or not.
    """
    folder = bag if bag.is_dir() else layout.unfinished(bag)
    if not folder.is_dir():
        raise ValueError(f"{bag} is not a bag")
    trash = folder.parent / TRASH
    trash.mkdir(exist_ok=True)
    old = folder.parent.resolve() / folder.name
    file = bag.parent.resolve().parent / FILE
    listed = read(file)
    to = folder.rename(layout.free_path(trash, folder.name))
    kept = [each for each in listed if each.resolve() != old]
    if kept != listed:
        write(file, kept)
    return to
