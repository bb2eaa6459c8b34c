# SPDX-License-Identifier: Apache-2.0
"""Writes rosbag2 bags with MCAP storage, of which a kill loses one second at most.

A bag being written is in `<name>.unfinished/`; closing it makes it `<name>/` by one rename. A bag
that was never closed keeps the first name, and `recovery` makes a bag of it.
"""

from __future__ import annotations

import fcntl
import json
import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import ClassVar

from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import Channel, McapWriter, write_channel, write_string

from wam_power_ros import durable_files
from wam_power_ros.bags import integrity
from wam_power_ros.bags.gaps import GapCounter
from wam_power_ros.bags.layout import EVENT, STRING, TYPES, qos, unfinished

DISTRIBUTION = "ros_distro: rosbags", "ros_distro: jazzy"  # as rosbags writes it, and corrected


def has_header(msgtype: str) -> bool:
    """Whether messages of a known type begin with a std_msgs/Header."""
    fields = TYPES.fielddefs[msgtype][1]
    return bool(fields) and fields[0][1][1] == "std_msgs/msg/Header"


def header_stamp(cdr: bytes) -> int:
    """Stamp [ns] of a serialized message that begins with a header.

    Raises:
        ValueError: The message is too short for a header.
    """
    if len(cdr) < 12:
        raise ValueError(f"message of {len(cdr)} bytes cannot hold a header")
    sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
    return sec * 1_000_000_000 + nanosec


class _Storage(McapWriter):
    """MCAP storage with what rosbags omits: checksums, hashes of the types, the distribution."""

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Add a channel as rosbag2 describes it."""
        notes = {
            "offered_qos_profiles": offered_qos_profiles,
            "topic_type_hash": connection.digest,
        }
        metadata = BytesIO()
        for text in chain(*notes.items()):
            write_string(metadata, text)
        self.channels.append(
            Channel(connection.id, connection.msgtype, connection.topic, "cdr", metadata.getvalue())
        )
        self.channel_stats[connection.id] = 0
        write_channel(self.chunk.bio, self.channels[-1], self.schemas)

    def close_chunk(self) -> None:
        """Write the chunk, then its checksum."""
        crc = zlib.crc32(self.chunk.bio.getbuffer())
        begin = self.bio.tell() + integrity.RECORD_HEADER.size + integrity.CHUNK_CRC_OFFSET
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(begin)
        self.bio.write(struct.pack("<I", crc))
        self.bio.seek(end)

    def close(self, version: int, metadata: str) -> None:
        """Close the file, then write its checksums."""
        super().close(version, metadata.replace(*DISTRIBUTION))
        integrity.seal(self.path)


class _Writer(Writer):
    STORAGE_PLUGINS: ClassVar = {StoragePlugin.MCAP: _Storage}

    def close(self) -> None:
        """Close the bag, then write the distribution to its metadata."""
        super().close()
        self.metapath.write_text(self.metapath.read_text("utf8").replace(*DISTRIBUTION), "utf8")


class BagWriter:
    """One bag being written; only `close` completes it.

    Attributes:
        path: Folder of the finished bag.
        counts: Number of messages written, by topic.
        stamps: Counter of gaps between header stamps, for each topic with headers.
    """

    def __init__(self, path: Path) -> None:
        """Begin the bag `path`.

        Raises:
            FileExistsError: The bag exists, finished or not.
            OSError: The folder cannot be written.
        """
        self.path = path
        self._parent = unfinished(path)
        if path.exists():
            raise FileExistsError(f"{path} exists already")
        self._parent.mkdir(parents=True)
        self._lock = os.open(self._parent, os.O_RDONLY)
        fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # `recover` refuses a locked bag
        self._writer = _Writer(
            self._parent / path.name, version=9, storage_plugin=StoragePlugin.MCAP
        )
        self._writer.open()
        self._connections: dict[str, Connection] = {}
        self.counts: dict[str, int] = {}
        self.stamps: dict[str, GapCounter] = {}

    def add(self, topic: str, msgtype: str, offered: Sequence[Qos]) -> None:
        """Add a topic with a message type of Jazzy's common interfaces.

        Raises:
            ValueError: The type is unknown, so the bag could not contain its definition.
        """
        if msgtype not in TYPES.fielddefs:
            raise ValueError(f"{topic}: {msgtype} is not a type of the common interfaces")
        self._connections[topic] = self._writer.add_connection(
            topic, msgtype, typestore=TYPES, offered_qos_profiles=list(offered)
        )
        self.counts[topic] = 0
        if has_header(msgtype):
            self.stamps[topic] = GapCounter()

    def write(self, topic: str, stamp_ns: int, cdr: bytes) -> None:
        """Write a serialized message received at `stamp_ns`; it is on the disk after `flush`.

        Raises:
            KeyError: The topic was not added.
            OSError: The disk refuses the message.
        """
        self._writer.write(self._connections[topic], stamp_ns, cdr)
        self.counts[topic] += 1
        if topic in self.stamps and len(cdr) >= 12:
            self.stamps[topic].add(header_stamp(cdr))

    def event(
        self, event: str, reason: str, stamp_ns: int, notes: Mapping[str, str] | None = None
    ) -> None:
        """Write an event of the recorder on topic EVENT.

        Notes for the metadata may be given with the first event, for recovery if the bag is never
        closed.

        Raises:
            OSError: The disk refuses the event.
        """
        if EVENT not in self.counts:
            self.add(EVENT, STRING, [qos(reliable=True, latched=True, depth=1)])
        text = json.dumps({"event": event, "reason": reason, **({"notes": notes} if notes else {})})
        message = TYPES.types[STRING](data=text)
        self.write(EVENT, stamp_ns, bytes(TYPES.serialize_cdr(message, STRING)))

    def flush(self) -> None:
        """Flush everything written so far to the disk, readable after a crash.

        Raises:
            OSError: The disk refuses the data.
        """
        storage = self._writer.storage
        if storage.chunk.msgs:
            storage.close_chunk()
        storage.bio.flush()
        os.fsync(storage.bio.fileno())

    def completeness(self, state_topic: str) -> dict[str, str]:
        """Notes for the metadata: rate of the state topic [Hz], and missing messages by topic."""
        found = {topic: counter.gaps() for topic, counter in self.stamps.items()}
        period = found[state_topic].period if state_topic in found else 0.0
        return {
            "rate": f"{1.0 / period:.1f}" if period else "0",
            "missing": json.dumps({topic: item.missing for topic, item in found.items()}),
        }

    def close(self, custom_data: Mapping[str, str]) -> Path:
        """Finish the bag, with notes for its metadata, and return its path.

        Raises:
            OSError: The disk refuses the data; the bag stays unfinished.
        """
        for key, value in custom_data.items():
            self._writer.set_custom_data(key, value)
        self.flush()
        self._writer.close()
        written = self._parent / self.path.name
        for file in (*written.iterdir(), written):
            durable_files.sync(file)
        written.rename(self.path)
        self._parent.rmdir()
        durable_files.sync(self.path.parent)
        os.close(self._lock)
        return self.path

    def abandon(self) -> None:
        """Stop writing and leave the bag unfinished, as a kill would."""
        try:
            self._writer.abort()
        except OSError:
            pass  # a disk that refused data before refuses the rest, too
        os.close(self._lock)
