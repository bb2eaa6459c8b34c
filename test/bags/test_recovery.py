# SPDX-License-Identifier: Apache-2.0
"""Recovery: every complete message is recovered, and everything else is reported."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_samples import LATCHED, NAMES, QOS, START, demonstration, joint_state, random_q, string
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from wam_power_ros.bags import layout
from wam_power_ros.bags.layout import unfinished
from wam_power_ros.bags.reader import read_demonstration
from wam_power_ros.bags.recovery import recover
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.cli import main


@pytest.mark.requirement("S-65")
def test_what_was_flushed_before_a_kill_is_recovered(tmp_path: Path) -> None:
    script = f"""
import sys, time
sys.path[:0] = {sys.path!r}
from pathlib import Path
from test_recovery import *
writer = BagWriter(Path({str(tmp_path)!r}) / "demo")
writer.add("/joint_states", layout.JOINT_STATE, QOS)
for index, row in enumerate(random_q()):
    writer.write("/joint_states", START, joint_state(START + index, NAMES, row))
    if index == 399:
        writer.flush()
print("written", flush=True)
time.sleep(60)
"""
    command = [sys.executable, "-c", script]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, cwd=Path(__file__).parent)
    try:
        assert process.stdout.readline() == b"written\n"
        with pytest.raises(ValueError, match="still being written"):
            recover(tmp_path / "demo")
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    path = recover(tmp_path / "demo").path
    _, back = read_demonstration(path, NAMES)
    assert len(back) >= 400
    np.testing.assert_array_equal(back, random_q()[: len(back)])


@pytest.mark.requirement("S-65")
@pytest.mark.parametrize("closed", [False, True])
def test_a_file_cut_anywhere_gives_back_every_complete_message(
    tmp_path: Path, closed: bool
) -> None:
    writer = BagWriter(tmp_path / "demo")
    writer.add("/robot_description", layout.STRING, LATCHED)
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    q, ends = random_q(60), []
    for index, row in enumerate(q):
        writer.write("/joint_states", START + index, joint_state(START + index, NAMES, row))
        if index % 20 == 19:
            writer.flush()
            ends.append((unfinished(writer.path) / "demo" / "demo.mcap").stat().st_size)
    if closed:
        file = writer.close({}) / "demo.mcap"
    else:
        writer.abandon()
        file = unfinished(tmp_path / "demo") / "demo" / "demo.mcap"
    whole = file.read_bytes()
    recovered = []
    drawn = np.random.default_rng(0).integers(9, len(whole), 12).tolist()
    for cut in sorted({*range(len(whole), 900, -1997), *drawn, 8, 0}, reverse=True):
        file.write_bytes(whole[:cut])
        path = recover(tmp_path / "demo").path
        with Reader(path) as bag:
            recovered.append(bag.message_count)
            for connection in bag.connections:
                assert connection.ext.offered_qos_profiles in (QOS, LATCHED)
        assert recovered[-1] >= 20 * sum(end <= cut for end in ends)
        if recovered[-1]:
            np.testing.assert_array_equal(read_demonstration(path, NAMES)[1], q[: recovered[-1]])
        path.rename(path.with_name(f"cut_{cut}"))
    assert recovered[0] == 60
    assert recovered == sorted(recovered, reverse=True)
    assert recovered[-1] == 0


def test_a_bag_cut_after_it_was_closed_keeps_what_was_noted(tmp_path: Path) -> None:
    path = demonstration(tmp_path / "demo", random_q(50))
    file = path / "demo.mcap"
    notes = json.dumps(NAMES)
    whole = file.read_bytes()
    file.write_bytes(whole[:-1])  # the summary is lost; the metadata within the file is not
    (path / "metadata.yaml").unlink()
    assert noted(recover(path).path)["joint_names"] == notes
    (tmp_path / "demo_recovered").rename(tmp_path / "first")

    (path / "metadata.yaml").write_text((tmp_path / "first" / "metadata.yaml").read_text())
    file.write_bytes(whole[: len(whole) // 2])  # nor is what metadata.yaml says
    made = recover(path)
    assert noted(made.path)["joint_names"] == notes
    assert noted(made.path)["recovered"] == "true"
    assert 0 < made.messages["/joint_states"] < 100
    back = read_demonstration(made.path, NAMES)[1]
    np.testing.assert_array_equal(back, random_q(50)[: len(back)])


def noted(path: Path) -> dict[str, str]:
    information = yaml.safe_load((path / "metadata.yaml").read_text())
    return information["rosbag2_bagfile_information"]["custom_data"]


def test_what_was_noted_at_the_start_outlives_a_kill(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "demo")
    names = ("q1", "q2", "q3")  # of another driver: only the notes tell their order
    writer.event("start", "demo", START, {"joint_names": json.dumps(names)})
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    for index, row in enumerate(random_q(20)):
        stamp_ns = START + 2_000_000 * index
        writer.write("/joint_states", stamp_ns, joint_state(stamp_ns, names, row))
    writer.flush()
    writer.abandon()
    path = recover(tmp_path / "demo.unfinished").path  # as the folder is called
    assert path == tmp_path / "demo_recovered"
    assert noted(path)["joint_names"] == json.dumps(names)
    np.testing.assert_array_equal(read_demonstration(path, NAMES)[1], random_q(20))


def test_a_lost_metadata_file_is_all_that_a_bag_without_one_lacks(tmp_path: Path) -> None:
    path = demonstration(tmp_path / "demo", random_q(50))
    (path / "metadata.yaml").unlink()
    with pytest.raises(ValueError, match=f"wam-power recover {path}"):
        read_demonstration(path, NAMES)
    made = recover(path)
    assert made.messages == {"/robot_description": 1, "/joint_states": 100}
    np.testing.assert_array_equal(read_demonstration(made.path, NAMES)[1], random_q(50))
    assert recover(path / "demo.mcap").path == path / "demo_recovered"  # the file is enough


def foreign(path: Path, compression: CompressionMode, storage: StoragePlugin) -> Path:
    """A bag of another recorder, with a type that is not of the common interfaces."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register({"lab_msgs/msg/Lamp": ([], [("on", (1, ("bool", 0)))])})
    writer = Writer(path, version=9, storage_plugin=storage)
    if compression is not CompressionMode.NONE:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        lamp = writer.add_connection("/lamp", "lab_msgs/msg/Lamp", typestore=store)
        text = writer.add_connection("/text", layout.STRING, typestore=store)
        writer.write(lamp, START, b"\x00\x01\x00\x00\x01")
        writer.write(text, START + 1, string("x"))
    return path


def test_a_topic_of_an_unknown_type_and_a_damaged_chunk_are_left_out_and_named(
    tmp_path: Path,
) -> None:
    path = foreign(tmp_path / "lab", CompressionMode.STORAGE, StoragePlugin.MCAP)
    made = recover(path)
    assert made.messages == {"/text": 1}
    assert "lab_msgs/msg/Lamp" in made.left_out["/lamp"]
    made.path.rename(tmp_path / "first")
    file = path / "lab.mcap"
    file.write_bytes(file.read_bytes().replace(b"\x28\xb5\x2f\xfd", bytes(4)))  # of zstd
    made = recover(path)
    assert sum(made.messages.values()) == 0
    assert any("chunk at byte" in part for part in made.left_out)


def test_what_cannot_be_recovered_is_refused_and_a_recovered_bag_is_never_replaced(
    tmp_path: Path,
) -> None:
    foreign(tmp_path / "lab", CompressionMode.NONE, StoragePlugin.SQLITE3)
    (tmp_path / "rubbish.mcap").write_bytes(b"0" * 100)
    for name, why in (
        ("lab", r"no .mcap file to recover; it has \['lab.db3'"),
        ("nowhere", "it has no files"),
        ("rubbish.mcap", "is not an MCAP file"),
    ):
        with pytest.raises(ValueError, match=why):
            recover(tmp_path / name)
    assert {file.name for file in tmp_path.iterdir()} == {"lab", "rubbish.mcap"}
    path = demonstration(tmp_path / "demo", random_q(5))
    assert main.main(["recover", str(path)]) == 0
    assert main.main(["recover", str(path)]) == 2  # it is there already
