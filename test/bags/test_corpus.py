# SPDX-License-Identifier: Apache-2.0
"""Sixty bags of other programs lose nothing of the arm; what is spoilt is refused, or shown."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_samples import START, joint_state, of_states
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from wam_power_ros.bags import importing, reader
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import JOINT_STATE, TYPES
from wam_power_ros.cli import main

SHIPPED = min((Path(__file__).resolve().parents[2] / "bags").glob("reach_*"))
WAM = tuple(f"wam_j{joint}" for joint in range(1, 8))
STAMPS, Q = reader.read_demonstration(SHIPPED, WAM)
STAMPS, Q = START + STAMPS[:1200] - STAMPS[0], Q[:1200]
DEFINITION = TYPES.generate_msgdef(JOINT_STATE, ros_version=2)[0].encode()
OTHERS = [  # encoding, schema's name and encoding of another topic
    ("json", "lab.Note", "jsonschema"),
    ("protobuf", "foxglove.CompressedVideo", "protobuf"),
    ("flatbuffer", "foxglove.PointCloud", "flatbuffer"),
    ("", "", ""),
    ("ros1", "sensor_msgs/Imu", "ros1msg"),
    ("cdr", "lab_msgs/msg/Own", "ros2msg"),
    ("cdr", "lab_msgs::Own", "omgidl"),
]
PACKINGS = [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4]
MCAPS = [*itertools.product(OTHERS, ["ros2", ""], PACKINGS)]  # 42
BARE = [*itertools.product([True, False], [IndexType.ALL, IndexType.NONE], ["", "ros2"])]  # 8
ROSBAGS = [*itertools.product(StoragePlugin, CompressionMode, [8, 9])]  # 2 * 3 or 4 * 2


def states() -> list[tuple[int, bytes]]:
    rows = zip(STAMPS.tolist(), Q, strict=True)
    return [(stamp + 300_000, joint_state(stamp, WAM, row)) for stamp, row in rows]


def whole(path: Path, to: Path) -> None:
    made, _ = importing.import_bag(Bag(path), to, WAM)
    back = reader.read_demonstration(made, WAM)
    np.testing.assert_array_equal(back[0], STAMPS)
    np.testing.assert_array_equal(back[1], Q)


@pytest.mark.parametrize(("other", "profile", "packing"), MCAPS)
def test_another_topic_costs_no_state(
    other: tuple[str, str, str], profile: str, packing: CompressionType, tmp_path: Path
) -> None:
    encoding, kind, schema = other
    with (file := tmp_path / "theirs.mcap").open("wb") as out:
        writer = McapWriter(out, compression=packing, chunk_size=20_000)
        writer.start(profile)
        number = writer.register_schema(kind, schema, b"\x0a\x02{}") if kind else 0
        there = writer.register_channel("/other", encoding, number)
        of = writer.register_schema(JOINT_STATE, "ros2msg", DEFINITION)
        arm = writer.register_channel("/joint_states", "cdr", of)
        for received, data in states():
            writer.add_message(there, received - 1, b"\xff\x00", 0)
            writer.add_message(arm, received, data, received)
        writer.finish()
    whole(file, tmp_path / "ours")


@pytest.mark.parametrize(("chunked", "index", "profile"), BARE)
def test_a_file_without_a_summary_or_chunks_is_whole(
    chunked: bool, index: IndexType, profile: str, tmp_path: Path
) -> None:
    bare = index is IndexType.NONE
    with (file := tmp_path / "theirs.mcap").open("wb") as out:
        writer = McapWriter(
            out,
            chunk_size=20_000,
            use_chunking=chunked,
            index_types=index,
            repeat_channels=not bare,
            repeat_schemas=not bare,
            use_statistics=not bare,
            use_summary_offsets=not bare,
        )
        writer.start(profile)
        of = writer.register_schema(JOINT_STATE, "ros2msg", DEFINITION)
        arm = writer.register_channel("/joint_states", "cdr", of)
        for received, data in states():
            writer.add_message(arm, received, data, received)
        writer.finish()
    whole(file, tmp_path / "ours")


@pytest.mark.parametrize(("storage", "packing", "version"), ROSBAGS)
def test_a_bag_of_rosbag2_is_whole(
    storage: StoragePlugin, packing: CompressionMode, version: int, tmp_path: Path
) -> None:
    writer = Writer(tmp_path / "theirs", version=version, storage_plugin=storage)
    if packing is CompressionMode.STORAGE and storage is not StoragePlugin.MCAP:
        pytest.skip("no such bags")
    if packing is not CompressionMode.NONE:
        writer.set_compression(packing, CompressionFormat.ZSTD)
    with writer:
        arm = writer.add_connection("/joint_states", JOINT_STATE, typestore=TYPES)
        text = writer.add_connection("/notes", "std_msgs/msg/String", typestore=TYPES)
        for received, data in states():
            writer.write(text, received - 1, b"\xff")  # no text at all
            writer.write(arm, received, data)
    whole(tmp_path / "theirs", tmp_path / "ours")


Spoil = Callable[[np.ndarray, np.ndarray, np.ndarray], object]


def changed(array: np.ndarray, place: object, value: object) -> None:
    array[place] = value  # type: ignore[index]


SPOILT: dict[str, Spoil] = {
    **{f"times {k}": lambda r, t, q, k=k: np.multiply(q, k, out=q) for k in (57.3, 1e3, 1e6, 1e-3)},
    **{
        f"joint {j} in degrees": lambda r, t, q, j=j: np.multiply(q[:, j], 57.3, out=q[:, j])
        for j in (0, 1, 3)
    },
    **{
        f"clock set back {s} s": lambda r, t, q, s=s: changed(t, slice(600, None), t[600:] - s)
        for s in (60_000_000, 10**9, 3600 * 10**9)
    },
    **{
        f"clock set on {s} s": lambda r, t, q, s=s: changed(t, slice(600, None), t[600:] + s)
        for s in (60_000_000, 10**9, 3600 * 10**9)
    },
    **{
        f"{n} states of yesterday": lambda r, t, q, n=n: changed(t, slice(n), t[:n] - 86400 * 10**9)
        for n in (1, 5, 12, 30)
    },
    **{
        f"{n} states lost": lambda r, t, q, n=n: changed(
            t, slice(600, None), t[600:] + 2_000_000 * n
        )
        for n in (20, 30, 600)
    },
    **{
        f"{n} states NaN": lambda r, t, q, n=n: changed(q, slice(600, 600 + n), np.nan)
        for n in (1, 20, 600)
    },
    **{
        f"joint {j} jumps by {x}": lambda r, t, q, j=j, x=x: changed(
            q, (slice(600, None), j), q[600:, j] + x
        )
        for j in (0, 3)
        for x in (0.5, 6.2832, 50.0)
    },
    **{
        f"reception {name}": lambda r, t, q, at=at: changed(r, slice(600, 603), at)
        for name, at in (("zero", 0), ("of the end of time", 2**63 - 5))
    },
    "a speed that no arm has": lambda r, t, q: changed(t, slice(None), t[0] + (t - t[0]) // 20),
    "no stamps": lambda r, t, q: changed(t, slice(None), 0),
    "one stamp": lambda r, t, q: changed(t, slice(None), t[0]),
    "stamps of half the rate": lambda r, t, q: changed(t, slice(None), t[0] + (t - t[0]) // 2 * 2),
    "a simulated clock": lambda r, t, q: changed(t, slice(None), t - t[0] + 1),
    "an hour of standstill": lambda r, t, q: changed(q, slice(None), q[0]),
    "stamps in reverse": lambda r, t, q: changed(t, slice(None), t[::-1].copy()),
    "a shuffled recording": lambda r, t, q: changed(
        q, slice(None), q[np.random.default_rng(1).permutation(len(q))]
    ),
    "noise of 0.05 rad": lambda r, t, q: np.add(
        q, np.random.default_rng(1).normal(0, 0.05, q.shape), out=q
    ),
}  # 40


@pytest.mark.parametrize("what", SPOILT)
def test_what_is_imported_can_be_shown(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    received, stamps, q = (STAMPS + 300_000).copy(), STAMPS.copy(), Q.copy()
    SPOILT[what](received, stamps, q)
    order = np.argsort(received, kind="stable")
    rows = zip(received[order].tolist(), stamps[order].tolist(), q[order], strict=True)
    theirs = of_states(tmp_path / "theirs", [(r, t, WAM, row) for r, t, row in rows])
    ours = tmp_path / "ours"
    status = main.main(["bags", "import", str(theirs), "--task", "reach", "--output", str(ours)])
    assert status in (0, 2)
    assert ours.exists() == (status == 0)
    assert capsys.readouterr().err.startswith("wam-power: " * (status == 2))
    if status == 0:
        assert main.main(["bags", "show", str(ours)]) == 0
        shutil.rmtree(ours)
