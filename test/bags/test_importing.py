# SPDX-License-Identifier: Apache-2.0
"""Imported bags have the right contents; their sources are unchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_samples import NAMES, QOS, START, demonstration, joint_state, of_states, random_q, string
from rosbags.rosbag2 import StoragePlugin, Writer

from wam_power_ros.arm_identity import ArmIdentity, to_json
from wam_power_ros.bags import importing, layout, reader
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import JOINT_STATE, TYPES
from wam_power_ros.bags.writer import BagWriter

THEIRS = ("panda_joint1", "panda_joint2", "panda_joint3")


def foreign(path: Path, q: np.ndarray, storage: StoragePlugin) -> Path:
    """A bag of another recorder: other joint names in another order, a gripper, another topic."""
    with Writer(path, version=9, storage_plugin=storage) as writer:
        states = writer.add_connection("/panda/joint_states", JOINT_STATE, typestore=TYPES)
        other = writer.add_connection("/chatter", layout.STRING, typestore=TYPES)
        writer.write(other, START, string("hello"))
        for index, row in enumerate(q):
            stamp = START + 10_000_000 * index
            names = ("finger", *reversed(THEIRS))
            values = np.array([0.04, *row[::-1]])
            writer.write(states, stamp, joint_state(stamp, names, values))
    return path


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_any_bag_with_joint_states_becomes_a_demonstration(
    storage: StoragePlugin, tmp_path: Path
) -> None:
    q = random_q(50)
    path = foreign(tmp_path / "theirs", q, storage)
    made, _ = importing.import_bag(Bag(path), tmp_path / "ours", NAMES, THEIRS, kind="reach")
    stamps, angles = reader.read_demonstration(made, NAMES)
    np.testing.assert_array_equal(angles, q)
    np.testing.assert_array_equal(np.diff(stamps), 10_000_000)
    assert Bag(made).kind == "reach"


def test_other_names_are_refused_with_those_that_are_there(tmp_path: Path) -> None:
    path = foreign(tmp_path / "theirs", random_q(5), StoragePlugin.MCAP)
    with pytest.raises(ValueError, match=r"it has .*'panda_joint1'.*--joints"):
        importing.import_bag(Bag(path), tmp_path / "ours", NAMES)
    with pytest.raises(ValueError, match=r"\['nose'\] missing among"):
        importing.import_bag(Bag(path), tmp_path / "ours", NAMES, (*THEIRS[:2], "nose"))
    with pytest.raises(ValueError, match="2 names"):
        importing.import_bag(Bag(path), tmp_path / "ours", NAMES, THEIRS[:2])
    assert [item.name for item in tmp_path.iterdir()] == ["theirs"]  # nothing is left behind


def test_of_several_topics_with_messages_one_has_to_be_named(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "two")
    for index, topic in enumerate(("/left", "/right", "/silent")):
        writer.add(topic, JOINT_STATE, QOS)
        if topic != "/silent":
            writer.write(topic, START, joint_state(START, NAMES, np.full(3, float(index))))
    path = writer.close({})
    with pytest.raises(ValueError, match="/left, /right; name one with --topic"):
        importing.import_bag(Bag(path), tmp_path / "ours", NAMES)
    made, _ = importing.import_bag(Bag(path), tmp_path / "ours", NAMES, topic="/right")
    assert reader.read_demonstration(made, NAMES)[1].tolist() == [[1.0, 1.0, 1.0]]


def test_a_bag_without_joint_states_is_refused_with_what_it_has(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "none")
    writer.event("start", "demo", START)
    with pytest.raises(ValueError, match="no topics of joint states: /recorder/event of std_msgs"):
        importing.import_bag(Bag(writer.close({})), tmp_path / "no", NAMES)


def test_an_import_keeps_the_identity_of_the_arm_and_joins_no_two_arms(tmp_path: Path) -> None:
    bags, arm = [], ArmIdentity("wam", NAMES, "0" * 64, "1" * 64)
    for name, notes in (("a", {"arm": to_json(arm)}), ("b", {})):
        writer = BagWriter(tmp_path / name)
        writer.add("/joint_states", JOINT_STATE, QOS)
        writer.write("/joint_states", START, joint_state(START, NAMES, np.ones(3)))
        bags.append(writer.close(notes))
    made, _ = importing.import_bag(Bag(bags[0]), tmp_path / "ours", NAMES)
    assert Bag(made).arm == arm
    with pytest.raises(ValueError, match="are of different arms"):
        Bag(*bags)


def test_a_part_without_a_state_exchanged_names_and_a_bag_that_is_there_are_refused(
    tmp_path: Path,
) -> None:
    path = demonstration(tmp_path / "take", random_q(20))
    with pytest.raises(ValueError, match="no state from 5"):
        importing.import_bag(Bag(path), tmp_path / "ours", NAMES, part=(5.0, 6.0))
    sorted_by_another_rule = (NAMES[1], NAMES[0], NAMES[2])
    with pytest.raises(ValueError, match="'wam_j2' is in the place of 'wam_j1'"):
        importing.import_bag(Bag(path), tmp_path / "ours", NAMES, sorted_by_another_rule)
    assert not (tmp_path / "ours").exists()
    with pytest.raises(FileExistsError):
        importing.import_bag(Bag(path), path, NAMES)
    assert len(reader.read_demonstration(path, NAMES)[0]) == 20


def test_a_time_of_reception_that_is_no_time_is_refused_and_can_be_cut_off(tmp_path: Path) -> None:
    q = random_q(50)
    times = [START + 4_000_000 * k for k in range(50)]
    states = [(t if k < 49 else 2**63 - 5, t, NAMES, q[k]) for k, t in enumerate(times)]
    bag, ours = Bag(of_states(tmp_path / "theirs", states)), tmp_path / "ours"
    with pytest.raises(ValueError, match="is no time of ROS"):
        importing.import_bag(bag, ours, NAMES, by_reception=True)
    importing.import_bag(bag, ours, NAMES, by_reception=True, part=(0.0, 9.0))
    np.testing.assert_array_equal(reader.read_demonstration(ours, NAMES)[1], q[:49])
