# SPDX-License-Identifier: Apache-2.0
"""Bags: rosbag2 in MCAP, written so that a kill loses a second at most, read by joint name.

A bag under way is in `<name>.unfinished/`; closing it makes it `<name>/` in one rename. A bag that
was never closed is still there under its first name, and `recovery` makes a bag of it.
"""

from __future__ import annotations

import fcntl
import json
import os
import struct
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

TYPES = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"
STATES = "/joint_states"
EVENT = "/recorder/event"  # start and stop of the recording, in the bag only
UNFINISHED = ".unfinished"
INFINITE = QosTime(9223372036, 854775807)  # how rosbag2 writes a duration without end
METADATA_MAX = 1_000_000  # bytes of metadata.yaml
DEPTH_MAX = 20  # of its nesting
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # builds plain data, runs nothing


def qos(reliable: bool, latched: bool, depth: int = 10) -> Qos:
    """A publisher's QoS as a bag notes it, so that playing it back offers the same."""
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=max(depth, 1),  # the graph does not tell: it says 0
        reliability=QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=INFINITE,
        lifespan=INFINITE,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=INFINITE,
        avoid_ros_namespace_conventions=False,
    )


def has_header(msgtype: str) -> bool:
    """Whether messages of a known type begin with a std_msgs/Header."""
    fields = TYPES.fielddefs[msgtype][1]
    return bool(fields) and fields[0][1][1] == "std_msgs/msg/Header"


def header_stamp(cdr: bytes) -> int:
    """Stamp [ns] of a serialized message that begins with a header.

    Raises:
        ValueError: The bytes are too few for one.
    """
    if len(cdr) < 12:
        raise ValueError(f"message of {len(cdr)} bytes cannot hold a header")
    sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
    return sec * 1_000_000_000 + nanosec


@dataclass(frozen=True)
class Gaps:
    """What the stamps of a topic say about its completeness.

    Attributes:
        period: Median time between messages [s].
        missing: Messages that would fill the intervals longer than 1.5 periods.
        longest: Longest interval [s].
    """

    period: float
    missing: int
    longest: float


class GapCounter:
    """Looks for gaps in the stamps of one topic as they come, in constant memory.

    The period is the median of the first `LEARNT` intervals; messages sent again count once.
    """

    LEARNT = 1000

    def __init__(self) -> None:
        self._last: int | None = None
        self._first_steps = array("q")  # [ns]
        self._period = 0.0  # [ns], 0 as long as it is not learnt
        self._missing = 0
        self._longest = 0  # [ns]

    def add(self, stamp_ns: int) -> None:
        """Take the next stamp [ns]."""
        step = 0 if self._last is None else stamp_ns - self._last
        self._last = stamp_ns
        if step <= 0:
            return
        self._longest = max(self._longest, step)
        if self._period:
            self._missing += _missing(step, self._period)
            return
        self._first_steps.append(step)
        if len(self._first_steps) == self.LEARNT:
            found = self.gaps()
            self._period, self._missing = found.period * 1e9, found.missing
            self._first_steps = array("q")

    def gaps(self) -> Gaps:
        """What the stamps so far say."""
        period, missing = self._period, self._missing
        if self._first_steps:
            period = float(np.median(self._first_steps))
            missing = sum(_missing(step, period) for step in self._first_steps)
        return Gaps(period * 1e-9, missing, self._longest * 1e-9)


def _missing(step: int, period: float) -> int:
    return round(step / period) - 1 if step > 1.5 * period else 0


def gaps(stamps_ns: Iterable[int]) -> Gaps:
    """Look for gaps in the stamps [ns] of one topic."""
    counter = GapCounter()
    for stamp_ns in stamps_ns:
        counter.add(int(stamp_ns))
    return counter.gaps()


class BagWriter:
    """One bag being written; `close` makes it a bag, anything else leaves it unfinished.

    Attributes:
        path: Where the bag will be.
        counts: Messages written, by topic.
        stamps: What the header stamps written say, by topic that has them.
    """

    def __init__(self, path: Path) -> None:
        """Begin the bag `path`.

        Raises:
            FileExistsError: It is there already, finished or not.
            OSError: The folder cannot be written.
        """
        self.path = path
        self._parent = unfinished(path)
        if path.exists():
            raise FileExistsError(f"{path} exists already")
        self._parent.mkdir(parents=True)
        self._lock = os.open(self._parent, os.O_RDONLY)
        fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # `recover` keeps off a live bag
        self._writer = Writer(
            self._parent / path.name, version=9, storage_plugin=StoragePlugin.MCAP
        )
        self._writer.open()
        self._connections: dict[str, Connection] = {}
        self.counts: dict[str, int] = {}
        self.stamps: dict[str, GapCounter] = {}

    def add(self, topic: str, msgtype: str, offered: Sequence[Qos]) -> None:
        """Add a topic, of a message type in Jazzy's common interfaces.

        Raises:
            ValueError: The type is not known, so its definition could not go into the bag.
        """
        if msgtype not in TYPES.fielddefs:
            raise ValueError(f"{topic}: type {msgtype} is not of the common interfaces")
        self._connections[topic] = self._writer.add_connection(
            topic, msgtype, typestore=TYPES, offered_qos_profiles=list(offered)
        )
        self.counts[topic] = 0
        if has_header(msgtype):
            self.stamps[topic] = GapCounter()

    def write(self, topic: str, stamp_ns: int, cdr: bytes) -> None:
        """Write a serialized message as received at `stamp_ns`; on the disk after `flush`.

        Raises:
            KeyError: The topic was not added.
            OSError: The disk refused.
        """
        self._writer.write(self._connections[topic], stamp_ns, cdr)
        self.counts[topic] += 1
        if topic in self.stamps and len(cdr) >= 12:
            self.stamps[topic].add(header_stamp(cdr))

    def event(
        self, event: str, reason: str, stamp_ns: int, notes: Mapping[str, str] | None = None
    ) -> None:
        """Note an event of the recording itself in the bag, on EVENT.

        Notes that are for the metadata may be given with the first event: should the bag never be
        closed, that is where they are found.

        Raises:
            OSError: The disk refused.
        """
        if EVENT not in self.counts:
            self.add(EVENT, STRING, [qos(reliable=True, latched=True, depth=1)])
        text = json.dumps({"event": event, "reason": reason, **({"notes": notes} if notes else {})})
        message = TYPES.types[STRING](data=text)
        self.write(EVENT, stamp_ns, bytes(TYPES.serialize_cdr(message, STRING)))

    def flush(self) -> None:
        """Put everything written so far on the disk, readable whatever happens next.

        Raises:
            OSError: The disk refused.
        """
        storage = self._writer.storage
        if storage.chunk.msgs:
            storage.close_chunk()
        storage.bio.flush()
        os.fsync(storage.bio.fileno())

    def completeness(self, state_topic: str) -> dict[str, str]:
        """Notes for the metadata: rate [Hz] of a topic, and what is missing on each."""
        found = {topic: counter.gaps() for topic, counter in self.stamps.items()}
        period = found[state_topic].period if state_topic in found else 0.0
        return {
            "rate": f"{1.0 / period:.1f}" if period else "0",
            "missing": json.dumps({topic: item.missing for topic, item in found.items()}),
        }

    def close(self, custom_data: Mapping[str, str]) -> Path:
        """Finish the bag, with notes for its metadata, and return its path.

        Raises:
            OSError: The disk refused; the bag stays unfinished.
        """
        for key, value in custom_data.items():
            self._writer.set_custom_data(key, value)
        self.flush()
        self._writer.close()
        written = self._parent / self.path.name
        for file in (*written.iterdir(), written):
            _sync(file)
        written.rename(self.path)
        self._parent.rmdir()
        _sync(self.path.parent)
        os.close(self._lock)
        return self.path

    def abandon(self) -> None:
        """Stop writing and leave the bag unfinished, as a kill would."""
        try:
            self._writer.abort()
        except OSError:
            pass  # the disk that refused before refuses its last bytes too
        os.close(self._lock)


def unfinished(path: Path) -> Path:
    """Where the bag `path` is kept until it is closed."""
    return path.with_name(path.name + UNFINISHED)


def free_path(directory: Path, stem: str) -> Path:
    """The first of stem, stem_2, stem_3... that is no bag yet, finished or not."""
    path, number = directory / stem, 1
    while path.exists() or unfinished(path).exists():
        number += 1
        path = directory / f"{stem}_{number}"
    return path


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def read_demonstration(
    path: Path | str, joint_names: Sequence[str], topic: str | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles from a rosbag2 bag, MCAP or SQLite, whoever recorded it.

    Joints are matched by name and time is that of the headers. Messages without any of our joints
    are another device's and left out, as are repetitions (same stamp, same angles). A bag taught
    under another driver has other names for the same joints: if it has none of ours, and notes as
    many (our recorder does, base to tip), these are taken.

    Args:
        path: Folder of the bag.
        joint_names: Order of the columns of the result.
        topic: Of type sensor_msgs/JointState; the one the bag notes, or /joint_states, if omitted.

    Returns:
        Stamps (M,) int64 [ns], strictly increasing, and angles (M, nj) [rad].

    Raises:
        ValueError: Naming what is wrong: no bag, no such topic, joints missing, a value that is not
            finite, stamps that go back.
    """
    path = Path(path)
    noted, noted_topic = _noted(path)
    topic = topic or noted_topic
    states = [_joint_angles(path, topic, cdr) for cdr in _messages(path, topic, JOINT_STATE)]
    ours = tuple(joint_names)
    seen = {name for _, angles in states for name in angles}
    if not seen & set(ours) and len(noted) == len(ours):
        ours = noted
    stamps: list[int] = []
    rows: list[tuple[float, ...]] = []
    for stamp_ns, angles in states:
        missing = [name for name in ours if name not in angles]
        if len(missing) == len(ours):
            continue
        if missing:
            raise ValueError(f"{path}: joints {missing} missing among {list(angles)} on {topic}")
        row = tuple(angles[name] for name in ours)
        if not np.isfinite(row).all():
            raise ValueError(f"{path}: position {row} at {stamp_ns} ns on {topic} is not finite")
        if stamps and stamp_ns <= stamps[-1]:
            if stamp_ns == stamps[-1] and row == rows[-1]:
                continue
            raise ValueError(f"{path}: stamp {stamp_ns} follows {stamps[-1]} on {topic}")
        stamps.append(stamp_ns)
        rows.append(row)
    if not stamps:
        raise ValueError(
            f"{path}: no message on {topic} has the joints {list(ours)}; it has {sorted(seen)}"
        )
    return np.array(stamps, dtype=np.int64), np.array(rows)


def _noted(path: Path) -> tuple[tuple[str, ...], str]:
    """Joint names, base to tip, and topic of the states as our recorder notes them in a bag."""
    _check_metadata(path)
    try:
        custom = custom_data(plain_yaml(path / "metadata.yaml"))
        names = tuple(map(str, json.loads(custom.get("joint_names", "[]"))))
        return names, str(custom.get("state_topic", STATES))
    except (ValueError, TypeError):
        return (), STATES  # another recorder's notes, or none


def custom_data(metadata: object) -> dict[str, str]:
    """What a recorder noted in the metadata of a bag; empty when there is nothing of the kind."""
    for key in ("rosbag2_bagfile_information", "custom_data"):
        if isinstance(metadata, dict) and key in metadata:
            metadata = metadata[key]
        elif key == "custom_data":
            return {}
    notes = metadata if isinstance(metadata, dict) else {}
    return {str(key): str(value) for key, value in notes.items()}


def _joint_angles(path: Path, topic: str, cdr: bytes) -> tuple[int, dict[str, float]]:
    try:
        message = TYPES.deserialize_cdr(cdr, JOINT_STATE)
    except Exception as error:  # whatever bytes make the decoder raise
        raise ValueError(f"{path}: a message on {topic} is not a JointState: {error}") from error
    stamp = message.header.stamp
    names, position = message.name, message.position.tolist()
    if len(names) != len(position) or len(set(names)) != len(names):
        raise ValueError(f"{path}: {len(position)} positions for names {names} on {topic}")
    return stamp.sec * 1_000_000_000 + stamp.nanosec, dict(zip(names, position, strict=True))


def _messages(path: Path, topic: str, msgtype: str) -> list[bytes]:
    """Serialized messages of a topic, in the order of reception."""
    found = topics(path)
    if topic not in found:
        raise ValueError(f"{path}: no topic {topic}; it has {sorted(found)}")
    if found[topic].msgtype != msgtype:
        raise ValueError(f"{path}: {topic} is of type {found[topic].msgtype}, not {msgtype}")
    return [cdr for _, _, cdr in messages(path, [topic])]


@dataclass(frozen=True)
class Topic:
    """What a bag says of one of its topics.

    Attributes:
        msgtype: As in "std_msgs/msg/String".
        offered: QoS of its publishers.
    """

    msgtype: str
    offered: tuple[Qos, ...]


def topics(path: Path) -> dict[str, Topic]:
    """Topics of a rosbag2 bag, in the order of their names.

    Raises:
        ValueError: It is no bag, or a topic has several types.
    """
    found: dict[str, Topic] = {}
    with _reading(path) as reader:
        for item in sorted(reader.connections, key=lambda item: item.topic):
            known = found.get(item.topic, Topic(item.msgtype, ()))
            if known.msgtype != item.msgtype:
                raise ValueError(f"{item.topic} is of type {known.msgtype} and {item.msgtype}")
            offered = (*known.offered, *item.ext.offered_qos_profiles)
            found[item.topic] = Topic(item.msgtype, offered)
    return found


def messages(path: Path, names: Iterable[str]) -> Iterator[tuple[str, int, bytes]]:
    """Topic, time of reception [ns] and bytes of the messages of some topics, in that order.

    Raises:
        ValueError: It is no bag, or damaged.
    """
    names = set(names)
    with _reading(path) as reader:
        kept = [item for item in reader.connections if item.topic in names]
        for connection, stamp_ns, cdr in reader.messages(kept) if kept else ():
            yield connection.topic, stamp_ns, cdr


@contextmanager
def _reading(path: Path) -> Iterator[Reader]:
    _check_metadata(path)
    try:
        with Reader(path) as reader:
            yield reader
    except Exception as error:  # whatever a damaged file makes the reader raise
        raise ValueError(f"{path} cannot be read as a bag: {error}") from error


def _check_metadata(path: Path) -> None:
    """Refuse a metadata.yaml that is not one before anything builds objects of it."""
    if unfinished(path).exists() and not path.exists():
        raise ValueError(f"{path} was never closed; recover it first: wam-power recover {path}")
    file = path / "metadata.yaml"
    if not file.is_file():
        raise ValueError(
            f"{path} is not a bag: it has no metadata.yaml; if it has an .mcap file: "
            f"wam-power recover {path}"
        )
    plain_yaml(file)


def plain_yaml(file: Path) -> object:
    """The plain data in a YAML file of a bag, hostile or not.

    Raises:
        ValueError: Too large, nested too deeply, with an alias, or not YAML.
    """
    size = file.stat().st_size
    if size > METADATA_MAX:
        raise ValueError(f"{file} has {size} bytes, at most {METADATA_MAX} are believed")
    return parse_plain(file.read_bytes(), str(file))


def parse_plain(text: bytes, where: str) -> object:
    """As `plain_yaml`, for text that came out of `where`."""
    depth = 0
    try:
        decoded = text.decode()
        for event in yaml.parse(decoded, Loader=LOADER):
            if isinstance(event, yaml.AliasEvent):
                raise ValueError(f"{where} has an alias, which no bag needs")
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEPTH_MAX:
                raise ValueError(f"{where} is nested deeper than {DEPTH_MAX}")
        return yaml.load(decoded, Loader=LOADER)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{where} is not plain YAML: {error}") from None
