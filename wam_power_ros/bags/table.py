# SPDX-License-Identifier: Apache-2.0
"""Tables for and of other programs: columns of a bag, and their file, CSV or Parquet.

A table is a dictionary of columns of equal length, whose cells are int, float, bool, str or None.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wam_power_ros import durable_files
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.files import TABLES
from wam_power_ros.bags.layout import JOINT_STATE, STAMP_END, STATES, TYPES, decoded, qos
from wam_power_ros.bags.quality import Grade, Remark
from wam_power_ros.bags.reader import States
from wam_power_ros.bags.writer import header_stamp, new_bag

ODOMETRY = "nav_msgs/msg/Odometry"
STATE = "/state"  # topic of a body below its name
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")  # [m], quaternion
STAMP = "stamp_ns"
TABLE = ".csv"  # suffix
TIMES = ("t", "time", "timestamp", "__time")  # columns of a time [s], if there is no STAMP
# Column of a joint's angle: its name, alone or as `bags export`, LeRobot or PlotJuggler write it
JOINT = re.compile(r"(?:q\.)?(?P<name>[^/]+?)(?:\.pos)?|.*/(?P<last>[^/]+)/position")


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
    if path.suffix not in TABLES:
        raise ValueError(f"{path} must end in {' or '.join(TABLES)}")
    if path.exists():
        raise FileExistsError(f"{path} exists already; name another file")
    if path.suffix == ".parquet":
        require_pyarrow()


def write(columns: Mapping[str, Sequence[Any]], path: Path) -> int:
    """Write a table to a new file; returns the number of its rows.

    CSV restores floats bit for bit; None is an empty cell, and null in Parquet.

    Raises:
        ValueError: As `check_new`.
        OSError: The file exists or cannot be written.
    """
    check_new(path)
    rows = [*zip(*columns.values(), strict=True)]
    if path.suffix == ".csv":
        csv.writer(text := io.StringIO()).writerows([columns, *rows])  # the repr of a float
        durable_files.replace(path, text.getvalue())
    else:
        durable_files.replace(path, _parquet(columns))
    return len(rows)


def _parquet(columns: Mapping[str, Sequence[Any]]) -> bytes:
    import pyarrow
    from pyarrow import parquet

    def array(values: Sequence[Any]) -> pyarrow.Array:
        empty = all(value is None for value in values)  # of numbers that were not recorded
        return pyarrow.array(values, type=pyarrow.float64() if empty else None)

    data = io.BytesIO()
    parquet.write_table(pyarrow.table({name: array(of) for name, of in columns.items()}), data)
    return data.getvalue()


def require_pyarrow() -> None:
    """Raise a ValueError that names the extra, if pyarrow is missing."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        text = 'Parquet needs pyarrow: pip install "wam_power_ros[export]"; a .csv table does not'
        raise ValueError(text) from None


def is_table(path: Path) -> bool:
    """Whether a path is a file of a table."""
    return path.suffix in TABLES and path.is_file()


def as_bag(path: Path, folder: Path, unit: float = 1.0) -> Path:
    """Write the joint angles of a table into a folder, as a bag that is named as the file.

    Every column of numbers is a joint's angles, in a unit of that many rad, but the time: STAMP
    [ns], or one of TIMES [s] from the first row on, which is at 1 s.

    Raises:
        ValueError: The file is no table, has no time or joint, or its times do not increase.
    """
    read = _read_csv if path.suffix == ".csv" else _read_parquet
    try:
        return to_bag(read(path), folder / path.name, unit)
    except (ValueError, csv.Error) as error:
        raise ValueError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None


def to_bag(columns: Sequence[tuple[str, Sequence[Any]]], to: Path, unit: float) -> Path:
    """Write a bag of columns with their names, see `as_bag`; raises a ValueError as that does."""
    numeric = [(name, cells) for name, cells in columns if _of_numbers(cells)]
    clock = next((name for name in (STAMP, *TIMES) if name in dict(numeric)), "")
    angles = [(name, _numbers(*each)) for name, *each in _joints(numeric)]
    if not clock or not angles:
        others = [name for name, cells in columns if not _of_numbers(cells)]
        raise ValueError(
            f"a table needs a time, {STAMP} [ns] or {' or '.join(TIMES)} [s], and a column of "
            f"angles [rad] with the name of each joint; it has {[*dict(numeric)]}, others: {others}"
        )
    times = _numbers(clock, dict(numeric)[clock], int if clock == STAMP else float)
    for row, (time, last) in enumerate(zip(times, [-math.inf, *times], strict=False), 2):
        if not last < time < math.inf:
            raise ValueError(
                f"{clock} of row {row} is {time} and follows {last}: times must increase, and each "
                "demonstration needs a file of its own"
            )
    tick = 1 if clock == STAMP else 1e9
    zero = 0 if clock == STAMP else times[0] - 1.0
    stamps = [round((time - zero) * tick) for time in times]
    if not 0 < stamps[0] <= stamps[-1] < STAMP_END:
        raise ValueError(f"{clock} from {times[0]} to {times[-1]} is no time of ROS")
    of, none = TYPES.types, np.zeros(0)
    names = np.array([name for name, _ in angles])
    with new_bag(to) as writer:
        writer.add(STATES, JOINT_STATE, [qos(reliable=True, latched=False)])
        for stamp, q in zip(stamps, unit * np.column_stack([q for _, q in angles]), strict=True):
            time = of["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
            header = of["std_msgs/msg/Header"](stamp=time, frame_id="")
            there = ~np.isnan(q)  # rows of other devices have no angle of the arm
            state = of[JOINT_STATE](header, names[there].tolist(), q[there], none, none)
            writer.write(STATES, stamp, bytes(TYPES.serialize_cdr(state, JOINT_STATE)))
        return writer.close({})


def _joints(columns: Iterable[tuple[str, Sequence[Any]]]) -> Iterator[tuple[str, str, Any]]:
    """Joint, column and cells of each column that is not the time."""
    for name, cells in columns:
        if name not in (STAMP, *TIMES):
            match = JOINT.fullmatch(name)
            yield (match["name"] or match["last"] if match else name), name, cells


def _of_numbers(cells: Sequence[Any]) -> bool:
    """Whether the first cell that is not empty is a number."""
    first = next((cell for cell in cells if cell not in ("", None)), math.nan)
    try:
        return isinstance(float(first), float)
    except (TypeError, ValueError):
        return False


def _numbers(name: str, cells: Sequence[Any], of: Callable[[Any], float] = float) -> list[float]:
    """Numbers of a column, NaN in an empty cell."""
    found = []
    for row, cell in enumerate(cells, 2):
        try:
            found.append(math.nan if cell in ("", None) else of(cell))
        except (TypeError, ValueError):
            raise ValueError(f"{name} of row {row} is {cell!r}, which is no number") from None
    return found


def _read_csv(path: Path) -> list[tuple[str, Sequence[Any]]]:
    """Columns of text; what separates the names separates all cells."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        delimiter = max(",;\t", key=file.readline().count)
        file.seek(0)
        rows = [row for row in csv.reader(file, delimiter=delimiter) if row]
    if delimiter == ";":  # of a program that writes decimal commas
        rows = [[cell.replace(",", ".") for cell in row] for row in rows]
    if len(rows) < 2:
        raise ValueError("a table needs a row of names, and a row for each state")
    for number, row in enumerate(rows, 1):
        if len(row) != len(rows[0]):
            raise ValueError(f"row {number} has {len(row)} cells for {len(rows[0])} columns")
    names, *cells = rows
    return [
        (name.strip(), each) for name, each in zip(names, zip(*cells, strict=True), strict=True)
    ]


def _read_parquet(path: Path) -> list[tuple[str, Sequence[Any]]]:
    require_pyarrow()
    from pyarrow import ArrowException, parquet

    try:
        found = parquet.read_table(path)
    except (ArrowException, OSError) as error:
        raise ValueError(f"is no Parquet file: {error}") from None
    columns = dict(zip(found.column_names, (of.to_pylist() for of in found.columns), strict=True))
    lists = [name for name, of in columns.items() if of and all(type(x) is list for x in of)]
    for name in lists:
        cells = columns.pop(name)  # as of LeRobot, whose names are in another file
        each = zip(*cells, strict=True)
        columns |= {f"{name}.{number}": [*of] for number, of in enumerate(each)}
    return [*columns.items()]
