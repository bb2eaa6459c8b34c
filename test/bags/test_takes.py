# SPDX-License-Identifier: Apache-2.0
"""Takes are found in folders and summarized."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bag_samples import NAMES, QOS, START, demonstration, joint_state, random_q

from wam_power_ros.bags import layout, series, takes
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.writer import BagWriter


def test_bags_are_found_wherever_they_are_but_not_in_the_trash(tmp_path: Path) -> None:
    kept = demonstration(tmp_path / "x" / "bags" / "demo_1", random_q(20))
    series.discard(demonstration(kept.with_name("demo_2"), random_q(20)))
    BagWriter(kept.with_name("demo_3")).abandon()
    assert takes.find([tmp_path]) == [kept, kept.with_name("demo_3")]
    assert takes.find([kept]) == [kept]
    assert takes.find([tmp_path / "none"]) == []


def test_a_take_is_of_the_kind_that_was_noted_whatever_its_name(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "demo_1")
    writer.event("start", "reach", START)
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    for index in range(5):
        stamp = START + 2_000_000 * index
        writer.write("/joint_states", stamp, joint_state(stamp, NAMES, np.zeros(3)))
    writer.event("stop", "shutdown", START + 10_000_000)
    bag = Bag(writer.close({}))
    assert bag.kind == "reach"
    assert takes.read(bag, NAMES).ended == "shutdown"
    assert Bag(demonstration(tmp_path / "stack_1", random_q(5))).kind == "stack"
