# SPDX-License-Identifier: Apache-2.0
"""Files of a bag, MCAP or SQLite: verified as a whole when opened, then read by topic.

`mcap`'s own reader verifies the checksums of each chunk and of all data, if the recorder wrote
them; ours does. A file is read from its begin and not by its index: nothing that follows the data
changes what is read, and no index or summary is needed. Any topic may be in a file, whatever its
encoding; only those that are used have to be readable.
"""

from __future__ import annotations

import sqlite3
from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from io import BytesIO
from itertools import accumulate
from operator import itemgetter
from pathlib import Path
from typing import Any

import lz4.frame
from backports import zstd
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from wam_power_ros import plain_yaml

FILES = (".mcap", ".db3")  # what a bag may consist of
TABLES = (".csv", ".parquet")  # files that are no bag, of which an import makes one
PACKED = ".zstd"  # suffix of a file that is compressed as a whole
# The largest chunk or message; rosbag2 writes chunks of 0.8 MB, other recorders of a few MB.
UNPACKED_MAX = 64_000_000  # [byte]
FILE_MAX = 4_000_000_000  # of a file that is compressed as a whole: six hours of ours [byte]
READ_SIZE = 1 << 20  # [byte]
ZSTD = b"\x28\xb5\x2f\xfd"  # begins compressed data; a message begins with a zero
WAL = "-wal"  # suffix of the messages beside a database that was not closed
OPENERS = {"lz4": lz4.frame.open, "zstd": zstd.open}

Received = tuple[str, int, bytes]  # topic, time of reception [ns], data


@dataclass(frozen=True)
class Topic:
    """A topic of a bag."""

    msgtype: str  # message type, such as "std_msgs/msg/String"; no such name if it is not of ROS 2
    found: int  # number of its messages

    @property
    def foreign(self) -> bool:
        """Whether its messages are not of one type of ROS 2, and are not read."""
        return " " in self.msgtype


def add_topic(topics: dict[str, Topic], name: str, topic: Topic) -> None:
    """Add a topic to others, of which one may have the same name; with two types it has neither."""
    known = topics.get(name, Topic(topic.msgtype, 0))
    kinds = dict.fromkeys(f"{known.msgtype} and {topic.msgtype}".split(" and "))
    topics[name] = Topic(" and ".join(kinds), known.found + topic.found)


def unpacked(data: bytes, compression: str) -> bytes:
    """Decompressed data, whatever size they declare; as they are if they are not compressed.

    Raises:
        ValueError: They are larger than UNPACKED_MAX, damaged, or of unknown compression.
    """
    if not compression:
        return data
    if compression not in OPENERS:
        raise ValueError(f"compression {compression!r} is not one of {', '.join(OPENERS)}")
    with OPENERS[compression](BytesIO(data)) as packed:
        raw: bytes = packed.read(UNPACKED_MAX + 1)
    if len(raw) > UNPACKED_MAX:
        raise ValueError(f"a chunk or message unpacks to more than {UNPACKED_MAX} bytes")
    return raw


def unpacked_file(file: Path, folder: Path) -> Path:
    """A file that is compressed as a whole, unpacked into a folder.

    Raises:
        ValueError: It is damaged, or larger than FILE_MAX.
    """
    to = folder / file.stem
    with zstd.open(file, "rb") as packed, to.open("xb") as out:
        while piece := packed.read(READ_SIZE):
            out.write(piece)
            if out.tell() > FILE_MAX:
                raise ValueError(f"{file} unpacks to more than {FILE_MAX} bytes")
    return to


class McapFile:
    """An MCAP file.

    Attributes:
        topics: Its topics by name.
        first: Time of the first reception [ns].
        sealed: Whether all its data have a checksum.
        information: Description of the bag that rosbag2 keeps in it; empty if there is none.
    """

    def __init__(self, path: Path) -> None:
        """Open and verify a file.

        Raises:
            Exception: It is damaged, truncated, or no MCAP file; of any type, by the damage.
        """
        self._path = path
        self.topics: dict[str, Topic] = {}
        self.sealed = False
        self.information: Mapping[str, Any] = {}
        self._names: dict[int, str] = {}  # of the topic of a channel
        schemas: dict[int, str] = {0: "no type"}
        channels: dict[int, Channel] = {}
        counts: Counter[int] = Counter()
        firsts = []
        for records in self._records(validate=True):
            stamps = [2**64]
            for record in records:
                if isinstance(record, Message):
                    counts[record.channel_id] += 1
                    stamps.append(record.log_time)
                elif isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel):
                    channels.setdefault(record.id, record)
                elif isinstance(record, Metadata):
                    text = record.metadata.get("serialized_metadata", "{}")
                    described = plain_yaml.parse(text.encode(), str(path))
                    if described and isinstance(described, dict):
                        self.information = described
                elif isinstance(record, DataEnd):
                    self.sealed = bool(record.data_section_crc)
            firsts.append(min(stamps))
        if unknown := counts.keys() - channels.keys():
            raise ValueError(f"{path} has messages on unknown channels {sorted(unknown)}")
        for number, channel in channels.items():
            of = schemas.get(channel.schema_id, "no type")
            ros = channel.message_encoding == "cdr"
            kind = of if ros else f"{of} in {channel.message_encoding or 'no encoding'}"
            self._names[number] = channel.topic
            add_topic(self.topics, channel.topic, Topic(kind, counts[number]))
        *self._later, self.first = accumulate(reversed([*firsts, 2**64]), min)  # from the end on

    def messages(self, names: Collection[str]) -> Iterator[Received]:
        """Messages on some topics, in the order of reception."""
        waiting: list[Received] = []  # those received after the first message of a later part
        for records, later in zip(self._records(), reversed(self._later), strict=True):
            for each in records:
                if isinstance(each, Message) and (name := self._names[each.channel_id]) in names:
                    waiting.append((name, each.log_time, each.data))
            waiting.sort(key=itemgetter(1))
            ready = bisect_right(waiting, later, key=itemgetter(1))
            yield from waiting[:ready]
            del waiting[:ready]

    def _records(self, validate: bool = False) -> Iterator[list[McapRecord]]:
        """Records up to the end of the data, those of a chunk together."""
        ended = False
        with self._path.open("rb") as file:
            reader = StreamReader(file, emit_chunks=True, validate_crcs=validate)
            try:
                for record in reader.records:
                    if not ended:
                        yield contents(record) if isinstance(record, Chunk) else [record]
                    ended |= isinstance(record, DataEnd)
            except EndOfFile:
                raise ValueError(
                    f"{self._path} ends within its records: it is truncated or damaged"
                ) from None
        if not ended:  # the library expects the record with the checksum, and does not miss it
            raise ValueError(f"{self._path} is damaged: it has no end of its data")


def contents(chunk: Chunk) -> list[McapRecord]:
    """Records in a chunk, verified if it has a checksum."""
    raw = unpacked(chunk.data, chunk.compression)
    if len(raw) != chunk.uncompressed_size:
        raise ValueError(f"a chunk has {len(raw)} bytes instead of {chunk.uncompressed_size}")
    return breakup_chunk(replace(chunk, data=raw, compression=""), validate_crc=True)


class SqliteFile:
    """A database; attributes as of `McapFile`. A changed value in a message is not detected."""

    sealed = False

    def __init__(self, path: Path) -> None:
        """Open and verify a database.

        Raises:
            ValueError: It was not closed: a recorder that was killed may leave its last messages in
                a file beside it, which is not read.
            sqlite3.Error: It is damaged, or no database.
        """
        self._path = path
        wal = path.with_name(path.name + WAL)
        if wal.exists() and wal.stat().st_size:
            raise ValueError(
                f"{path} was not closed: {wal.name} holds messages that are not in it yet; "
                f"sqlite3 {path} 'PRAGMA wal_checkpoint(TRUNCATE)' moves them there"
            )
        self.information: Mapping[str, Any] = {}
        self.topics: dict[str, Topic] = {}
        with self._database() as database:
            (verdict,) = database.execute("PRAGMA quick_check(1)").fetchone()
            if verdict != "ok":
                raise ValueError(f"{path} is damaged: {verdict}")
            counts = "SELECT topic_id, count(*), min(timestamp) FROM messages GROUP BY topic_id"
            found = {number: each for number, *each in database.execute(counts)}
            self.first = min((first for _, first in found.values()), default=2**64)
            for row in map(dict, database.execute("SELECT * FROM topics")):
                ros = row["serialization_format"] == "cdr"
                kind = row["type"] if ros else f"{row['type']} in {row['serialization_format']}"
                count, _ = found.get(row["id"], (0, 0))
                add_topic(self.topics, row["name"], Topic(kind, count))

    def messages(self, names: Collection[str]) -> Iterator[Received]:
        """Messages on some topics, in the order of reception."""
        chosen = f"topics.name IN ({', '.join('?' * len(names))})"
        query = (
            "SELECT topics.name, messages.timestamp, "
            f"CASE WHEN length(messages.data) <= {UNPACKED_MAX} THEN messages.data END "
            f"FROM messages JOIN topics ON topics.id = messages.topic_id WHERE {chosen} "
            "ORDER BY messages.timestamp, messages.id"
        )
        with self._database() as database:
            for name, stamp_ns, data in database.execute(query, [*names]):
                if data is None:
                    raise ValueError(f"a message on {name} has more than {UNPACKED_MAX} bytes")
                yield name, stamp_ns, data

    def _database(self) -> closing[sqlite3.Connection]:
        address = f"{self._path.absolute().as_uri()}?mode=ro&immutable=1"
        database = sqlite3.connect(address, uri=True)
        database.row_factory = sqlite3.Row
        return closing(database)


def opened(path: Path) -> McapFile | SqliteFile:
    """File of a bag, verified.

    Raises:
        Exception: As `McapFile` and `SqliteFile`, or it is neither.
    """
    if path.suffix not in FILES:
        raise ValueError(f"{path.name} is not an .mcap or .db3 file")
    return McapFile(path) if path.suffix == ".mcap" else SqliteFile(path)
