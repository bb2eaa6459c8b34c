# SPDX-License-Identifier: Apache-2.0
"""Judgements are kept with their bags, and used only while nothing has changed."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import count
from pathlib import Path

import pytest

from wam_power_ros.bags.judgements import FILE, Judgements


@pytest.fixture
def code(tmp_path: Path) -> Path:
    folder = tmp_path / "code"
    folder.mkdir()
    (folder / "judge.py").write_text("1")
    return folder


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "bag.mcap").write_bytes(b"states")
    return folder


@pytest.fixture
def judge() -> Callable[[], tuple[str, ...]]:
    """Its answer is another each time."""
    numbers = count()
    return lambda: (f"good {next(numbers)}", "")


def test_a_judgement_is_used_until_bag_code_or_set_up_change(
    code: Path, bag: Path, judge: Callable[[], tuple[str, ...]]
) -> None:
    first = Judgements([code], ["wam7"]).of(bag, judge)
    assert Judgements([code], ["wam7"]).of(bag, judge) == first
    assert Judgements([code], ["fr3"]).of(bag, judge) == ("good 1", "")
    (code / "judge.py").write_text("2")
    assert Judgements([code], ["fr3"]).of(bag, judge) == ("good 2", "")
    (bag / "bag.mcap").write_bytes(b"States")
    assert Judgements([code], ["fr3"]).of(bag, judge) == ("good 3", "")
    (bag / "more.mcap").write_bytes(b"")
    assert Judgements([code], ["fr3"]).of(bag, judge) == ("good 4", "")


def test_a_folder_that_cannot_be_written_is_judged_each_time(
    code: Path, bag: Path, judge: Callable[[], tuple[str, ...]]
) -> None:
    (bag / FILE).mkdir()  # also for root, who may write everywhere
    assert Judgements([code], []).of(bag, judge) == ("good 0", "")
    assert Judgements([code], []).of(bag, judge) == ("good 1", "")


@pytest.mark.parametrize("texts", ["good", ["\x1b[2J"], [1], [], ["x" * 30_000]])
def test_what_is_no_judgement_is_ignored(
    code: Path, bag: Path, judge: Callable[[], tuple[str, ...]], texts: object
) -> None:
    kept = Judgements([code], [])
    kept.of(bag, judge)
    written = json.loads((bag / FILE).read_text())
    (bag / FILE).write_text(json.dumps({**written, "texts": texts}))
    assert kept.of(bag, judge) == ("good 1", "")
    (bag / FILE).write_text("{")
    assert kept.of(bag, judge) == ("good 2", "")


def test_a_bag_that_changes_while_it_is_judged_keeps_no_judgement(code: Path, bag: Path) -> None:
    def grow() -> tuple[str, ...]:
        (bag / "bag.mcap").write_bytes(b"states and more")
        return ("good",)

    assert Judgements([code], []).of(bag, grow) == ("good",)
    assert not (bag / FILE).exists()
