# SPDX-License-Identifier: Apache-2.0
"""Bags are written as rosbag2 in MCAP, so that a kill loses a second at most.

A bag under way is in `<name>.unfinished/`; closing it makes it `<name>/` in one rename. A bag that
was never closed is still there under its first name, and `recovery` makes a bag of it.
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

DISTRIBUTION = "ros_distro: rosbags", "ros_distro: jazzy"  # what rosbags writes, and what it is


def has_header(msgtype: str) -> bool:
    """Whether messages of a known type begin with a std_msgs/Header."""
    fields = TYPES.fielddefs[msgtype][1]
    return bool(fields) and fields[0][1][1] == "std_msgs/msg/Header"


def header_stamp(cdr: bytes) -> int:
    """Stamp [ns] of a serialized message that begins with a header.

    Raises:
        ValueError: When the bytes are too few for one.
    """
    if len(cdr) < 12:
        raise ValueError(f"message of {len(cdr)} bytes cannot hold a header")
    sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
    return sec * 1_000_000_000 + nanosec


class _Storage(McapWriter):
    """MCAP with what rosbags leaves out: checksums, hashes of the types, the distribution."""

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
        begin = self.bio.tell() + integrity.RECORD_HEADER.size + integrity.CHUNK_CRC_AT
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(begin)
        self.bio.write(struct.pack("<I", crc))
        self.bio.seek(end)

    def close(self, version: int, metadata: str) -> None:
        """Close the file, then write the checksums of the whole of it."""
        super().close(version, metadata.replace(*DISTRIBUTION))
        integrity.seal(self.path)


class _Writer(Writer):
    STORAGE_PLUGINS: ClassVar = {StoragePlugin.MCAP: _Storage}

    def close(self) -> None:
        """Close the bag, then name the distribution in its metadata."""
        super().close()
        self.metapath.write_text(self.metapath.read_text("utf8").replace(*DISTRIBUTION), "utf8")


class BagWriter:
    """One bag being written; `close` makes it a bag, anything else leaves it unfinished.

    Attributes:
        path: Folder of the finished bag.
        counts: Number of messages written, by topic.
        stamps: Counter of gaps between header stamps, by topic that has them.
    """

    def __init__(self, path: Path) -> None:
        """Begin the bag `path`.

        Raises:
            FileExistsError: When it exists, finished or not.
            OSError: When the folder cannot be written.
        """
        self.path = path
        self._parent = unfinished(path)
        if path.exists():
            raise FileExistsError(f"{path} exists already")
        self._parent.mkdir(parents=True)
        self._lock = os.open(self._parent, os.O_RDONLY)
        fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # `recover` keeps off a live bag
        self._writer = _Writer(
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
            OSError: When the disk refuses.
        """
        self._writer.write(self._connections[topic], stamp_ns, cdr)
        self.counts[topic] += 1
        if topic in self.stamps and len(cdr) >= 12:
            self.stamps[topic].add(header_stamp(cdr))

    def event(
        self, event: str, reason: str, stamp_ns: int, notes: Mapping[str, str] | None = None
    ) -> None:
        """Write an event of the recording itself, on topic EVENT.

        Notes for the metadata may be given with the first event, where they are found if the bag
        is never closed.

        Raises:
            OSError: When the disk refuses.
        """
        if EVENT not in self.counts:
            self.add(EVENT, STRING, [qos(reliable=True, latched=True, depth=1)])
        text = json.dumps({"event": event, "reason": reason, **({"notes": notes} if notes else {})})
        message = TYPES.types[STRING](data=text)
        self.write(EVENT, stamp_ns, bytes(TYPES.serialize_cdr(message, STRING)))

    def flush(self) -> None:
        """Flush everything written so far to the disk, readable after a crash.

        Raises:
            OSError: When the disk refuses.
        """
        storage = self._writer.storage
        if storage.chunk.msgs:
            storage.close_chunk()
        storage.bio.flush()
        os.fsync(storage.bio.fileno())

    def completeness(self, state_topic: str) -> dict[str, str]:
        """Notes for the metadata: rate of a topic [Hz], and number of messages missing on each."""
        found = {topic: counter.gaps() for topic, counter in self.stamps.items()}
        period = found[state_topic].period if state_topic in found else 0.0
        return {
            "rate": f"{1.0 / period:.1f}" if period else "0",
            "missing": json.dumps({topic: item.missing for topic, item in found.items()}),
        }

    def close(self, custom_data: Mapping[str, str]) -> Path:
        """Finish the bag, with notes for its metadata, and return its path.

        Raises:
            OSError: When the disk refuses; the bag stays unfinished.
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
            pass  # the disk that refused before refuses its last bytes too
        os.close(self._lock)
