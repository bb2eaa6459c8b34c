# SPDX-License-Identifier: Apache-2.0
"""A bag is opened and verified once, whatever is read of it."""

from __future__ import annotations

import shutil
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from bag_samples import NAMES, demonstration, random_q

from wam_power_ros.bags import files
from wam_power_ros.bags.reader import read_demonstration
from wam_power_ros.cli import main
from wam_power_ros.params.resources import share

BAGS = share("bags")

_heard: list[Counter[str]] = []  # counters of the tests under way


def _hear(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and _heard and isinstance(arguments[0], str):
        path = Path(arguments[0])
        if path.suffix != ".pyc":  # of a module that is imported when it is needed
            _heard[-1][path.name] += 1


sys.addaudithook(_hear)  # hears every file that any library opens; cannot be removed


@pytest.fixture
def opened() -> Iterator[Counter[str]]:
    """Number of openings by name of the file."""
    _heard.append(Counter())
    yield _heard[-1]
    _heard.clear()


@pytest.fixture
def verified(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Number of verifications by name of the file."""
    count: Counter[str] = Counter()
    verify = files.opened

    def counting(file: Path) -> files.McapFile | files.SqliteFile:
        count[file.name] += 1
        return verify(file)

    monkeypatch.setattr(files, "opened", counting)
    return count


def test_reading_a_demonstration_opens_its_metadata_and_verifies_its_file_once(
    tmp_path: Path, opened: Counter[str], verified: Counter[str]
) -> None:
    path = demonstration(tmp_path / "demo", random_q(50))
    opened.clear()
    read_demonstration(path, NAMES)
    assert verified == {"demo.mcap": 1}
    assert opened == {"metadata.yaml": 1, "demo.mcap": 2}  # to verify, to read


def test_listing_opens_no_bag_and_grading_verifies_each_once(
    opened: Counter[str], verified: Counter[str], tmp_path: Path
) -> None:
    bags = tmp_path / "bags"
    shutil.copytree(BAGS, bags)
    names = [file.name for file in bags.glob("*/*.mcap")]
    opened.clear()
    assert main.main(["bags", "list", str(bags)]) == 0
    assert opened["metadata.yaml"] == len(names) > 2 and not verified
    assert main.main(["bags", "show", *map(str, bags.glob("*_*"))]) == 0
    assert verified == dict.fromkeys(names, 1)
