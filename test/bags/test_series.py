# SPDX-License-Identifier: Apache-2.0
"""A series of demonstrations stays correct when bags are discarded."""

from __future__ import annotations

from pathlib import Path

import pytest
from bag_samples import demonstration, random_q

from wam_power_ros.bags import layout, series
from wam_power_ros.bags.bag import Bag


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A series of two bags."""
    bags = [demonstration(tmp_path / "bags" / name, random_q(20)) for name in ("a", "b")]
    series.write(tmp_path / series.FILE, bags)
    return tmp_path / series.FILE


def test_no_list_is_an_empty_series_and_another_text_is_refused(tmp_path: Path) -> None:
    assert series.read(tmp_path / series.FILE) == []
    for text in ("{}", "[1]", '["a"'):
        (tmp_path / series.FILE).write_text(text)
        with pytest.raises(ValueError, match=r"demonstrations\.json"):
            series.read(tmp_path / series.FILE)


def test_discarded_bags_leave_the_series_and_are_all_still_there(file: Path) -> None:
    first, second = series.read(file)
    before = Bag(first).topics
    moved = series.discard(first)
    assert series.read(file) == [second]
    assert not first.exists() and Bag(moved).topics == before
    other = series.discard(demonstration(first, random_q(20)))  # of the same name
    assert moved != other and moved.is_dir() and other.is_dir()


def test_a_bag_that_was_never_closed_can_be_discarded(tmp_path: Path) -> None:
    left = layout.unfinished(tmp_path / "bags" / "left")
    (left / "left").mkdir(parents=True)
    assert series.discard(tmp_path / "bags" / "left").is_dir()
    assert not left.exists()


@pytest.mark.parametrize("way", ["link/bags/a", "real/bags/../bags/a"])
def test_a_bag_that_is_named_another_way_is_the_one_in_its_series(way: str, tmp_path: Path) -> None:
    bag = demonstration(tmp_path / "real/bags/a", random_q(20))
    (tmp_path / "link").symlink_to(tmp_path / "real")
    series.write(tmp_path / "real" / series.FILE, [bag])
    series.discard(tmp_path / way)
    assert bag not in series.read(tmp_path / "real" / series.FILE)
