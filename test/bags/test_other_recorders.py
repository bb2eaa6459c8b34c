# SPDX-License-Identifier: Apache-2.0
"""Bags as other recorders and drivers leave them are read whole, mended aloud, or refused."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from bag_samples import NAMES, START, joint_state, of_states, random_q
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from wam_power_ros.bags import importing, takes
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import JOINT_STATE, TYPES
from wam_power_ros.bags.reader import States, read_states

MS = 1_000_000
PERIOD = 4 * MS
Q = random_q(60)
STAMPS = START + PERIOD * np.arange(len(Q))
ARM = [(stamp + MS, stamp, NAMES, row) for stamp, row in zip(STAMPS.tolist(), Q, strict=True)]
GRIPPER = [(received + 600_000, stamp + 600_000, ("grip",), [0.1]) for received, stamp, *_ in ARM]


def by_reception(states: list) -> list:
    return sorted(states, key=lambda state: state[0])


def whole(states: States) -> None:
    np.testing.assert_array_equal(states.q, Q)
    np.testing.assert_array_equal(states.stamps, STAMPS)


def remarks(states: States) -> list[str]:
    return [remark.text for remark in states.remarks]


def recorded(
    path: Path,
    states: list,
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    packed: CompressionMode = CompressionMode.NONE,
) -> Path:
    """A bag as rosbag2 writes it."""
    writer = Writer(path, version=9, storage_plugin=storage)
    if packed is not CompressionMode.NONE:
        writer.set_compression(packed, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/joint_states", JOINT_STATE, typestore=TYPES)
        for received, stamp, names, row in states:
            writer.write(topic, received, joint_state(stamp, names, np.asarray(row)))
    return path


PACKED = [
    (storage, mode)
    for storage in StoragePlugin
    for mode in (CompressionMode.NONE, CompressionMode.MESSAGE, CompressionMode.FILE)
]


@pytest.mark.parametrize(
    ("storage", "packed"), [*PACKED, (StoragePlugin.MCAP, CompressionMode.STORAGE)]
)
def test_a_folder_and_its_lone_file_are_bags_however_compressed(
    storage: StoragePlugin, packed: CompressionMode, tmp_path: Path
) -> None:
    folder = recorded(tmp_path / "bag", ARM, storage, packed)
    whole(read_states(Bag(folder), NAMES))
    (file,) = (item for item in folder.iterdir() if item.suffix != ".yaml")
    lone = file.rename(tmp_path / file.name)
    whole(read_states(Bag(lone), NAMES))
    with pytest.raises(ValueError, match=r"name its \.mcap or \.db3 file"):
        Bag(tmp_path)


def test_late_states_are_put_in_the_order_of_their_stamps(tmp_path: Path) -> None:
    states = ARM.copy()
    for at in (10, 30):
        states[at : at + 2] = [
            (states[at][0], *states[at + 1][1:]),
            (states[at + 1][0], *states[at][1:]),
        ]
    found = read_states(Bag(of_states(tmp_path / "swapped", states)), NAMES)
    whole(found)
    assert remarks(found) == ["2 late states put in the order of stamps"]


def test_a_copy_that_comes_later_is_left_out(tmp_path: Path) -> None:
    twice = by_reception(ARM + [(received + 5 * MS, *state) for received, *state in ARM])
    found = read_states(Bag(of_states(tmp_path / "twice", twice)), NAMES)
    whole(found)
    assert remarks(found) == ["60 repetitions left out"]


def test_a_clock_that_was_set_back_is_refused_unless_by_reception(tmp_path: Path) -> None:
    states = [
        (received, stamp - 500 * MS if at >= 30 else stamp, names, row)
        for at, (received, stamp, names, row) in enumerate(ARM)
    ]
    path = of_states(tmp_path / "back", states)
    with pytest.raises(ValueError, match="--by-reception"):
        read_states(Bag(path), NAMES)
    found = read_states(Bag(path), NAMES, by_reception=True)
    np.testing.assert_array_equal(found.q, Q)
    np.testing.assert_array_equal(found.stamps, STAMPS + MS)
    made, _ = importing.import_bag(Bag(path), tmp_path / "ours", NAMES, by_reception=True)
    np.testing.assert_array_equal(read_states(Bag(made), NAMES).stamps, STAMPS + MS)


def test_joints_in_messages_of_two_kinds_are_refused(tmp_path: Path) -> None:
    states = [*ARM, (ARM[-1][0] + 1, ARM[-1][1] + MS, NAMES[:1], [0.0])]
    with pytest.raises(ValueError, match="messages of several kinds"):
        read_states(Bag(of_states(tmp_path / "both", states)), NAMES)


def test_gaps_are_those_of_the_arm_whatever_else_is_on_its_topic(tmp_path: Path) -> None:
    two = Bag(of_states(tmp_path / "two", by_reception(ARM + GRIPPER)))
    assert takes.read(two, NAMES).missing == {"/joint_states": 0}
    cut = by_reception(ARM[:20] + ARM[25:] + GRIPPER[:40] + GRIPPER[45:])
    missing = takes.read(Bag(of_states(tmp_path / "cut", cut)), NAMES).missing
    assert missing == {"/joint_states": 5}


def test_a_part_is_counted_from_the_first_state_of_the_arm(tmp_path: Path) -> None:
    early = [
        (START - 40 * MS + i * MS, START - 40 * MS + i * MS, ("grip",), [0.0]) for i in range(9)
    ]
    path = of_states(tmp_path / "theirs", early + ARM)
    made, _ = importing.import_bag(Bag(path), tmp_path / "part", NAMES, part=(0.04, 0.08))
    np.testing.assert_array_equal(read_states(Bag(made), NAMES).stamps, STAMPS[10:21])


def test_messages_beside_a_database_that_was_not_closed_are_not_lost(tmp_path: Path) -> None:
    (file,) = recorded(tmp_path / "bag", ARM).glob("*.db3")
    killed = tmp_path / "killed.db3"
    database = sqlite3.connect(file)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("PRAGMA wal_autocheckpoint=0")
    rows = database.execute("SELECT * FROM messages WHERE id > 30").fetchall()
    with database:
        database.execute("DELETE FROM messages WHERE id > 30")
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    with database:
        database.executemany(f"INSERT INTO messages VALUES ({','.join('?' * len(rows[0]))})", rows)
    for end in ("", "-wal"):
        shutil.copy(f"{file}{end}", f"{killed}{end}")
    database.close()
    with pytest.raises(ValueError, match=r"not closed: killed.db3-wal.*wal_checkpoint\(TRUNCATE\)"):
        Bag(killed)
    with sqlite3.connect(killed) as database:  # as the message says
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    database.close()
    whole(read_states(Bag(killed), NAMES))


def test_the_files_of_a_split_bag_without_metadata_are_imported_together(tmp_path: Path) -> None:
    files = []
    (tmp_path / "split").mkdir()
    for number, part in enumerate((ARM[:30], ARM[30:])):
        (file,) = recorded(tmp_path / f"{number}", part, StoragePlugin.MCAP).glob("*.mcap")
        files.append(file.rename(tmp_path / f"split/split_{number}.mcap"))
    advice = " ".join(["wam-power bags import", *map(str, files)])
    with pytest.raises(ValueError, match=advice):
        Bag(tmp_path / "split")
    made, _ = importing.import_bag(Bag(*files), tmp_path / "merged", NAMES)
    whole(read_states(Bag(made), NAMES))


def test_a_bag_of_ros_1_is_refused_with_the_command_that_converts_it(tmp_path: Path) -> None:
    (file := tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(ValueError, match=f"rosbags-convert --src {file} --dst {tmp_path}/old"):
        Bag(file)


def test_states_without_a_stamp_among_others_are_left_out(tmp_path: Path) -> None:
    simulated = [
        (received, 0 if at < 4 else stamp - START + 12_000 * MS, names, row)
        for at, (received, stamp, names, row) in enumerate(ARM)
    ]  # before the first message of the simulated clock
    path = of_states(tmp_path / "simulated", simulated)
    found = read_states(Bag(path), NAMES)
    np.testing.assert_array_equal(found.q, Q[4:])
    assert remarks(found) == ["4 of 60 states left out: they have no stamp"]
    none = [(received, 0, names, row) for received, _, names, row in ARM]
    found = read_states(Bag(of_states(tmp_path / "none", none)), NAMES)
    np.testing.assert_array_equal(found.stamps, STAMPS + MS)


def test_a_joint_that_is_there_twice_is_read_if_its_angles_are_equal(tmp_path: Path) -> None:
    twice = [(r, s, (*names, *names), [*row, *row]) for r, s, names, row in ARM]
    whole(read_states(Bag(of_states(tmp_path / "equal", twice)), NAMES))
    twice = [(r, s, (*names, names[0]), [*row, row[0] + 0.1]) for r, s, names, row in ARM]
    with pytest.raises(ValueError, match="a name is there twice, with two angles"):
        read_states(Bag(of_states(tmp_path / "unequal", twice)), NAMES)


def beside(file: Path, encoding: str, kind: str, schema: str) -> Path:
    """The states of the arm in an MCAP file, and on /other a message of another program.

    With an empty `kind`, /other has no schema; it begins with the type of the states if `encoding`
    is "cdr".
    """
    definition, _ = TYPES.generate_msgdef(JOINT_STATE, ros_version=2)
    with file.open("wb") as out:
        writer = McapWriter(out)
        writer.start("")
        states = writer.register_schema(JOINT_STATE, "ros2msg", definition.encode())
        other = writer.register_schema(kind, schema, b"{}") if kind else 0
        channels = [writer.register_channel("/joint_states", "cdr", states)]
        if encoding == "cdr":
            writer.register_channel("/other", encoding, states)
        channels.append(writer.register_channel("/other", encoding, other))
        for received, stamp, names, row in ARM:
            state = joint_state(stamp, names, np.asarray(row))
            for channel, data in zip(channels, (state, b"{}"), strict=True):
                writer.add_message(channel, received, data, received)
        writer.finish()
    return file


@pytest.mark.parametrize(
    ("encoding", "kind", "schema", "of"),
    [
        ("json", "Lamp", "jsonschema", "Lamp in json"),
        ("protobuf", "lab.Lamp", "protobuf", "lab.Lamp in protobuf"),
        ("json", "", "", "no type in json"),
        ("", "", "", "no type in no encoding"),
        ("ros1", "sensor_msgs/JointState", "ros1msg", "sensor_msgs/JointState in ros1"),
        ("cdr", "lab_msgs/msg/Lamp", "ros2msg", f"{JOINT_STATE} and lab_msgs/msg/Lamp"),
    ],
)
def test_no_other_topic_makes_a_bag_unreadable(
    encoding: str, kind: str, schema: str, of: str, tmp_path: Path
) -> None:
    bag = Bag(beside(tmp_path / "theirs.mcap", encoding, kind, schema))
    whole(states := read_states(bag, NAMES))
    assert remarks(states) == [f"not read: /other ({of})"] * (" " in of)
    assert bag.topics["/other"].msgtype == of
    assert takes.read(bag, NAMES).counts == {"/joint_states": 60, "/other": 60}
    with pytest.raises(ValueError, match="/other is of type"):
        read_states(bag, NAMES, "/other")
    made, _ = importing.import_bag(bag, tmp_path / "ours", NAMES)
    whole(read_states(Bag(made), NAMES))


@pytest.mark.parametrize("packing", [CompressionType.LZ4, CompressionType.ZSTD, None])
def test_a_file_without_a_summary_or_chunks_is_read_in_the_order_of_reception(
    packing: CompressionType | None, tmp_path: Path
) -> None:
    definition, _ = TYPES.generate_msgdef(JOINT_STATE, ros_version=2)
    with (file := tmp_path / "theirs.mcap").open("wb") as out:
        writer = McapWriter(
            out,
            chunk_size=2000,
            compression=packing or CompressionType.NONE,
            use_chunking=packing is not None,
            index_types=IndexType.NONE,
            repeat_channels=False,
            repeat_schemas=False,
            use_statistics=False,
            use_summary_offsets=False,
        )
        writer.start("ros2")
        states = writer.register_schema(JOINT_STATE, "ros2msg", definition.encode())
        channel = writer.register_channel("/joint_states", "cdr", states)
        for received, stamp, names, row in np.random.default_rng(0).permutation(
            np.array(ARM, dtype=object)
        ):
            state = joint_state(stamp, names, np.asarray(row))
            writer.add_message(channel, received, state, received)
        writer.finish()
    bag = Bag(file)
    whole(read_states(bag, NAMES))
    assert [stamp for _, stamp, _ in bag.messages(bag.topics)] == [state[0] for state in ARM]
