# SPDX-License-Identifier: Apache-2.0
"""Damaged bags are refused, and the unpacked size is bounded."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from backports import zstd
from bag_samples import NAMES, QOS, START, demonstration, joint_state, random_q
from mcap.opcode import Opcode
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from wam_power_ros.bags import layout
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.reader import read_demonstration
from wam_power_ros.bags.recovery import recover
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.params.resources import share

SHIPPED = sorted(path.parent for path in share("bags").glob("*/metadata.yaml"))
CHUNK = Opcode.CHUNK
HEADER = struct.Struct("<BQ")  # opcode and size of a record
CHUNK_HEADER = struct.Struct("<QQQI")  # first and last stamp, unpacked size, checksum
MEMORY = 400_000_000  # [byte] that a reader of a small bag may take
DISK = 200_000_000  # [byte] that it may write into one file


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A closed bag of three chunks."""
    writer = BagWriter(tmp_path / "demo")
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    for index, row in enumerate(random_q(60)):
        stamp_ns = START + 2_000_000 * index
        writer.write("/joint_states", stamp_ns, joint_state(stamp_ns, NAMES, row))
        if index % 20 == 19:
            writer.flush()
    return writer.close({"joint_names": json.dumps(NAMES), "state_topic": "/joint_states"})


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Offset, opcode and length of the records of an MCAP file."""
    at = 8
    while at < len(data) - 8:
        opcode, length = HEADER.unpack_from(data, at)
        yield at, opcode, length
        at += HEADER.size + length


def flipped(data: bytes, place: int, bit: int) -> bytes:
    damaged = bytearray(data)
    damaged[place] ^= 1 << bit
    return bytes(damaged)


def unsealed(data: bytes) -> bytes:
    """The file with the checksums of its chunks only, as other recorders write it."""
    found = bytearray(data)
    for at, opcode, _ in records(data):
        if opcode == Opcode.DATA_END:
            found[at + 9 : at + 13] = bytes(4)
        elif opcode == Opcode.FOOTER:
            found[at + 25 : at + 29] = bytes(4)
    return bytes(found)


@pytest.mark.requirement("S-57")
def test_no_flipped_bit_of_a_bag_is_read_as_another_movement(bag: Path) -> None:
    rng = np.random.default_rng()  # other bytes each time
    for file in (bag / "demo.mcap", bag / "metadata.yaml"):
        whole = file.read_bytes()
        places = rng.integers(0, len(whole), 100).tolist()
        if file.suffix == ".mcap":
            places += [at for at, *_ in records(whole)]  # each opcode
            (end,) = (at for at, opcode, _ in records(whole) if opcode == Opcode.DATA_END)
        for place in places:
            file.write_bytes(flipped(whole, place, int(rng.integers(8))))
            try:
                stamps_ns, q = read_demonstration(bag, NAMES)
            except ValueError as error:
                assert str(bag) in str(error)
            else:  # behind the data, or in a value that nobody uses
                assert file.name == "metadata.yaml" or place >= end
                np.testing.assert_array_equal(q, random_q(60))
                np.testing.assert_array_equal(stamps_ns, START + 2_000_000 * np.arange(60))
        file.write_bytes(whole)


@pytest.mark.requirement("S-57")
def test_a_flipped_bit_in_a_chunk_of_another_recorder_is_refused(bag: Path) -> None:
    file = bag / "demo.mcap"
    whole = unsealed(file.read_bytes())
    file.write_bytes(whole)
    np.testing.assert_array_equal(read_demonstration(bag, NAMES)[1], random_q(60))
    chunks = [(at, length) for at, opcode, length in records(whole) if opcode == CHUNK]
    assert len(chunks) == 3
    rng = np.random.default_rng(1)
    for at, length in chunks:
        for place in rng.integers(CHUNK_HEADER.size + 12, length, 40):
            file.write_bytes(flipped(whole, at + 9 + int(place), int(rng.integers(8))))
            with pytest.raises(ValueError, match="crc validation failed in Chunk"):
                read_demonstration(bag, NAMES)


@pytest.mark.requirement("S-57")
def test_recovery_leaves_a_damaged_chunk_out_and_names_it(bag: Path) -> None:
    file = bag / "demo.mcap"
    whole = file.read_bytes()
    chunks = [(at, length) for at, opcode, length in records(whole) if opcode == CHUNK]
    rng = np.random.default_rng(2)
    for number, (at, length) in enumerate(chunks):
        for _ in range(4):
            place = at + 9 + int(rng.integers(CHUNK_HEADER.size + 12, length))
            file.write_bytes(flipped(whole, place, int(rng.integers(8))))
            made = recover(bag)
            assert f"demo.mcap, chunk at byte {at}" in made.left_out
            if number:  # the first one has the topics
                kept = np.delete(random_q(60), slice(20 * number, 20 * number + 20), axis=0)
                np.testing.assert_array_equal(read_demonstration(made.path, NAMES)[1], kept)
            shutil.rmtree(made.path)


@pytest.mark.requirement("S-57")
@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda path: path.name)
def test_a_shipped_bag_has_checksums_and_a_flipped_byte_in_it_is_refused_by_name(
    shipped: Path, tmp_path: Path
) -> None:
    copy = Path(shutil.copytree(shipped, tmp_path / shipped.name))
    file = copy / f"{copy.name}.mcap"
    whole = file.read_bytes()
    for at, opcode, length in records(whole):
        body = whole[at + HEADER.size :][:length]
        if opcode == CHUNK:
            assert CHUNK_HEADER.unpack_from(body)[3]
        elif opcode in (Opcode.DATA_END, Opcode.FOOTER):  # the checksum is last
            assert any(body[-4:])
    (end,) = (at for at, opcode, _ in records(whole) if opcode == Opcode.DATA_END)
    for place in np.random.default_rng(3).integers(0, end, 10).tolist():
        file.write_bytes(flipped(whole, place, 0))
        with pytest.raises(ValueError, match=str(copy)):
            Bag(copy)
    file.write_bytes(whole)
    assert Bag(copy).notes == Bag(shipped).notes


@pytest.mark.requirement("S-57")
@pytest.mark.parametrize("name", ["starting_time", "custom_data"])
def test_metadata_that_differ_from_the_copy_in_the_file_are_refused(bag: Path, name: str) -> None:
    file = bag / "metadata.yaml"
    text = file.read_text()
    old = {"starting_time": str(START), "custom_data": "wam_j1"}[name]
    new = {"starting_time": str(START + 1), "custom_data": "wam_j9"}[name]
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(ValueError, match=rf"metadata\.yaml.*{name}"):
        read_demonstration(bag, NAMES)


def compressed(path: Path, mode: CompressionMode, storage: StoragePlugin, q: np.ndarray) -> Path:
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection(
            "/joint_states", layout.JOINT_STATE, typestore=layout.TYPES, offered_qos_profiles=QOS
        )
        for index, row in enumerate(q):
            stamp_ns = START + 2_000_000 * index
            writer.write(topic, stamp_ns, joint_state(stamp_ns, NAMES, row))
    return path


# Bombs: small bags that would unpack to more than a reader may take.

LARGE = 500_000_000  # [byte]


@cache
def zeros(size: int) -> bytes:
    """Many zeros, compressed by zstd, some ten thousand times smaller."""
    packer = zstd.ZstdCompressor()
    pieces = [packer.compress(bytes(10_000_000)) for _ in range(size // 10_000_000)]
    return b"".join([*pieces, packer.flush()])


def chunk_bomb(path: Path, declared: int, compression: str, content: bytes) -> None:
    """Replace the first chunk of a bag, and its description in the index."""
    demonstration(path, random_q(5))
    file = path / "demo.mcap"
    whole = unsealed(file.read_bytes())
    at, length = next((at, length) for at, opcode, length in records(whole) if opcode == CHUNK)
    body = CHUNK_HEADER.pack(START, START + 1, declared, 0)
    body += struct.pack("<I", len(compression)) + compression.encode()
    body += struct.pack("<Q", len(content)) + content
    made = whole[:at] + HEADER.pack(CHUNK, len(body)) + body + whole[at + 9 + length :]
    footer = len(made) - 8 - 29  # the summary is found no more: the file is read from its begin
    file.write_bytes(made[: footer + 9] + bytes(20) + made[-8:])


def zstd_chunk_of_a_declared_size(path: Path) -> None:
    chunk_bomb(path, LARGE, "zstd", zeros(LARGE))


def zstd_chunk_that_declares_less(path: Path) -> None:
    chunk_bomb(path, 1000, "zstd", zeros(LARGE))


def lz4_chunk_that_declares_less(path: Path) -> None:
    chunk_bomb(path, 1000, "lz4", lz4.frame.compress(bytes(LARGE)))


def file_bomb(path: Path) -> None:
    compressed(path, CompressionMode.FILE, StoragePlugin.MCAP, random_q(5))
    (path / "demo.mcap.zstd").write_bytes(zeros(400_000_000))


def message_bomb(path: Path) -> None:
    compressed(path, CompressionMode.MESSAGE, StoragePlugin.SQLITE3, random_q(5))
    with sqlite3.connect(path / "demo.db3") as database:
        database.execute("UPDATE messages SET data = ?", (zeros(LARGE),))


def computed_rows(path: Path) -> None:
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection("/joint_states", layout.JOINT_STATE, typestore=layout.TYPES)
        writer.write(topic, START, joint_state(START, NAMES, np.zeros(3)))
    with sqlite3.connect(path / "demo.db3") as database:
        database.execute("ALTER TABLE messages RENAME TO old")
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB GENERATED ALWAYS AS (zeroblob(900000000)))"
        )
        database.execute("INSERT INTO messages(topic_id, timestamp) SELECT 1, 1 FROM old")


BOMBS = {
    zstd_chunk_of_a_declared_size: "unpacks to more than 64000000 bytes",
    zstd_chunk_that_declares_less: "unpacks to more than 64000000 bytes",
    lz4_chunk_that_declares_less: "unpacks to more than 64000000 bytes",
    file_bomb: "File too large",
    message_bomb: "unpacks to more than 64000000 bytes",
    computed_rows: "a message on /joint_states has more than 64000000 bytes",
}


@pytest.mark.requirement("S-58")
def test_a_small_bag_that_unpacks_to_a_large_one_is_refused_in_bounded_memory_and_disk(
    tmp_path: Path,
) -> None:
    bags = [tmp_path / make.__name__ / "demo" for make in BOMBS]
    for make, bag in zip(BOMBS, bags, strict=True):
        bag.parent.mkdir()
        make(bag)
    script = f"""
import resource, sys
sys.path[:0] = {sys.path!r}
from pathlib import Path
from wam_power_ros.bags.reader import read_demonstration
pages = int(Path("/proc/self/statm").read_text().split()[0])
most = pages * resource.getpagesize() + {MEMORY}
resource.setrlimit(resource.RLIMIT_AS, (most, most))
resource.setrlimit(resource.RLIMIT_FSIZE, ({DISK}, {DISK}))
for bag in {[*map(str, bags)]!r}:
    try:
        read_demonstration(Path(bag), {NAMES!r})
        print("read")
    except ValueError as error:
        print(error)
"""
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    environment = os.environ | {"TMPDIR": str(scratch), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", script]
    ended = subprocess.run(
        command, capture_output=True, text=True, timeout=300, env=environment, check=False
    )
    assert ended.returncode == 0, ended.stderr
    for why, said in zip(BOMBS.values(), ended.stdout.splitlines(), strict=True):
        assert why in said
    assert list(scratch.iterdir()) == []
