# SPDX-License-Identifier: Apache-2.0
"""Tables for other programs: columns of a bag, and their file, CSV or Parquet.

A table is a dictionary of columns of equal length, whose cells are int, float, bool, str or None.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wam_power_ros import durable_files
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import JOINT_STATE, STATES, decoded
from wam_power_ros.bags.quality import Grade, Remark
from wam_power_ros.bags.reader import States
from wam_power_ros.bags.writer import header_stamp

ODOMETRY = "nav_msgs/msg/Odometry"
STATE = "/state"  # topic of a body below its name
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")  # [m], quaternion
SUFFIXES = (".csv", ".parquet")


def joint_columns(bag: Bag, states: States) -> dict[str, list[Any]]:
    """Columns of an arm's states, a row for each.

    These are t [s] since the first state, stamp_ns, and q [rad], qd [rad/s] and effort [N m] of
    each joint, "q.NAME". Speeds and efforts are those of the same messages, None where it has none.
    """
    stamps = states.stamps
    columns = {"t": ((stamps - stamps[0]) / 1e9).tolist(), "stamp_ns": stamps.tolist()}
    columns |= {f"q.{name}": q.tolist() for name, q in zip(states.names, states.q.T, strict=True)}
    topic = bag.notes.get("state_topic", STATES)
    messages = [cdr for _, _, cdr in bag.messages([topic])]
    read = [decoded(messages[index], JOINT_STATE) for index in states.index]
    for prefix, field in (("qd", "velocity"), ("effort", "effort")):
        rows = [_by_name(each.name, getattr(each, field).tolist()) for each in read]
        columns |= {f"{prefix}.{name}": [row.get(name) for row in rows] for name in states.names}
    return columns


def _by_name(names: Sequence[str], values: Sequence[float]) -> dict[str, float]:
    """Values by joint; empty if there is not one for each."""
    return dict(zip(names, values, strict=True)) if len(names) == len(values) else {}


def pose_columns(name: str, poses: Iterable[Sequence[float | None]]) -> dict[str, list[Any]]:
    """Columns "NAME.x" to "NAME.qw" of poses: position [m] and quaternion xyzw. Shape (M, 7)."""
    rows = [*poses]
    return {f"{name}.{part}": [row[i] for row in rows] for i, part in enumerate(POSE)}


def body_columns(bag: Bag, stamps: np.ndarray) -> tuple[dict[str, list[Any]], tuple[Remark, ...]]:
    """Columns of the last pose of each tracked body at some stamps [ns]; None before its first one.

    A body's columns are "body.NAME.stamp_ns", the stamp of that pose, and "body.NAME.x" to
    "body.NAME.qw" in the base frame.

    Returns:
        The columns, and a remark on the poses that no row has.
    """
    columns: dict[str, list[Any]] = {}
    remarks = []
    for topic in bag.topics:
        if not topic.endswith(STATE) or bag.topics[topic].msgtype != ODOMETRY:
            continue
        name = topic.removesuffix(STATE).strip("/").replace("/", ".")
        poses = {None: (None,) * len(POSE)} | dict(body_poses(bag, topic))
        known = np.array(sorted(stamp for stamp in poses if stamp is not None), dtype=np.int64)
        last = np.searchsorted(known, stamps, side="right") - 1
        found = [int(known[index]) if index >= 0 else None for index in last]
        columns[f"body.{name}.stamp_ns"] = found
        columns |= pose_columns(f"body.{name}", [poses[stamp] for stamp in found])
        if unused := len(known) - len({*found} - {None}):
            text = f"{unused} of {len(known)} poses of {name} are in no row: they precede the first"
            text += " state, or another one precedes the next state"
            remarks.append(Remark(Grade.FAIR, text))
    return columns, tuple(remarks)


def body_poses(bag: Bag, topic: str) -> Iterable[tuple[int, tuple[float, ...]]]:
    """Stamp [ns], position [m] and quaternion xyzw of each state of a body."""
    for _, _, cdr in bag.messages([topic]):
        p, o = (pose := decoded(cdr, ODOMETRY).pose.pose).position, pose.orientation
        yield header_stamp(cdr), (p.x, p.y, p.z, o.x, o.y, o.z, o.w)


def check_new(path: Path) -> None:
    """Check that a table can be written to a file.

    Raises:
        ValueError: The suffix is unknown, or pyarrow is missing for Parquet.
        FileExistsError: The file exists.
    """
    if path.suffix not in SUFFIXES:
        raise ValueError(f"{path} must end in {' or '.join(SUFFIXES)}")
    if path.exists():
        raise FileExistsError(f"{path} exists already; name another file")
    if path.suffix == ".parquet":
        try:
            import pyarrow.parquet  # noqa: F401
        except ImportError:
            raise ValueError(
                'Parquet needs pyarrow: pip install "wam_power_ros[export]"; or name a .csv file'
            ) from None


def write(columns: Mapping[str, Sequence[Any]], path: Path) -> int:
    """Write a table to a new file, which is read back before it has its name.

    CSV restores floats bit for bit; None is an empty cell, and null in Parquet.

    Returns:
        Number of rows.

    Raises:
        ValueError: As `check_new`.
        OSError: The file exists, cannot be written, or has not all rows; it is then removed.
    """
    check_new(path)
    rows = len(next(iter(columns.values())))
    part = path.with_name(f".{path.name}.part")
    try:
        written = (_write_csv if path.suffix == ".csv" else _write_parquet)(columns, part)
        if written != rows:
            raise OSError(f"{path}: {written} of {rows} rows could be read back")
        durable_files.sync(part)
        part.replace(path)
        durable_files.sync(path.parent)
    finally:
        part.unlink(missing_ok=True)
    return rows


def _write_csv(columns: Mapping[str, Sequence[Any]], path: Path) -> int:
    """Write a CSV file; returns the number of complete rows that are in it."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)  # which writes the repr of a float
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    with path.open(encoding="utf-8", newline="") as file:
        return sum(len(row) == len(columns) for row in csv.reader(file)) - 1


def _write_parquet(columns: Mapping[str, Sequence[Any]], path: Path) -> int:
    """Write a Parquet file; returns the number of rows that are in it."""
    import pyarrow
    from pyarrow import parquet

    def array(values: Sequence[Any]) -> pyarrow.Array:
        empty = all(value is None for value in values)  # of numbers that were not recorded
        return pyarrow.array(values, type=pyarrow.float64() if empty else None)

    table = pyarrow.table({name: array(values) for name, values in columns.items()})
    parquet.write_table(table, path)
    return int(parquet.read_table(path).num_rows)
