# SPDX-License-Identifier: Apache-2.0
"""Writes rosbag2 bags with MCAP storage, of which a kill loses one second at most.

A bag being written is in `<name>.unfinished/`; closing it makes it `<name>/` by one rename. A bag
that was never closed keeps the first name, and `recovery` makes a bag of it.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Qos

from wam_power_ros import durable_files
from wam_power_ros.bags.layout import EVENT, STRING, TYPES, described_qos, qos, unfinished

_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # the same text, in a tenth of the time
METADATA_VERSION = 9  # of metadata.yaml, that of Jazzy


def header_stamp(cdr: bytes) -> int:
    """Stamp [ns] of a serialized message that begins with a header.

    Raises:
        ValueError: The message is too short for a header.
    """
    if len(cdr) < 12:
        raise ValueError(f"message of {len(cdr)} bytes cannot hold a header")
    sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
    return sec * 1_000_000_000 + nanosec


@dataclass
class _Channel:
    """A topic being written."""

    number: int
    metadata: dict[str, Any]
    count: int = 0


class BagWriter:
    """One bag being written; only `close` completes it and makes it the folder `path`."""

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
        self._written = self._parent / path.name
        self._written.mkdir()
        self._file = (self._written / f"{path.name}.mcap").open("xb")
        self._writer = Writer(self._file, compression=CompressionType.NONE, enable_data_crcs=True)
        self._writer.start("ros2")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, _Channel] = {}
        self._first_ns, self._last_ns = 2**63 - 1, 0

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages written, by topic."""
        return {topic: channel.count for topic, channel in list(self._channels.items())}

    def add(self, topic: str, msgtype: str, offered: Sequence[Qos]) -> None:
        """Add a topic with a message type of Jazzy's common interfaces.

        Raises:
            ValueError: The type is unknown, so the bag could not contain its definition.
        """
        if msgtype not in TYPES.fielddefs:
            raise ValueError(f"{topic}: {msgtype} is not a type of the common interfaces")
        if msgtype not in self._schemas:
            definition, _ = TYPES.generate_msgdef(msgtype, ros_version=2)
            schema = self._writer.register_schema(msgtype, "ros2msg", definition.encode())
            self._schemas[msgtype] = schema
        metadata = {
            "name": topic,
            "type": msgtype,
            "serialization_format": "cdr",
            "offered_qos_profiles": described_qos(offered),
            "type_description_hash": TYPES.hash_rihs01(msgtype),
        }
        notes = {
            "offered_qos_profiles": _yaml(metadata["offered_qos_profiles"]),
            "topic_type_hash": metadata["type_description_hash"],
        }
        number = self._writer.register_channel(topic, "cdr", self._schemas[msgtype], notes)
        self._channels[topic] = _Channel(number, metadata)

    def write(self, topic: str, stamp_ns: int, cdr: bytes) -> None:
        """Write a serialized message received at `stamp_ns`; it is on the disk after `flush`.

        Raises:
            KeyError: The topic was not added.
            OSError: The disk refuses the message.
        """
        channel = self._channels[topic]
        self._writer.add_message(channel.number, stamp_ns, cdr, stamp_ns)
        channel.count += 1
        self._first_ns = min(self._first_ns, stamp_ns)
        self._last_ns = max(self._last_ns, stamp_ns)

    def event(
        self, event: str, reason: str, stamp_ns: int, notes: Mapping[str, str] | None = None
    ) -> None:
        """Write an event of the recorder on topic EVENT.

        Notes for the metadata may be given with the first event, for recovery if the bag is never
        closed.

        Raises:
            OSError: The disk refuses the event.
        """
        if EVENT not in self._channels:
            self.add(EVENT, STRING, [qos(reliable=True, latched=True, depth=1)])
        text = json.dumps({"event": event, "reason": reason, **({"notes": notes} if notes else {})})
        message = TYPES.types[STRING](data=text)
        self.write(EVENT, stamp_ns, bytes(TYPES.serialize_cdr(message, STRING)))

    def flush(self) -> None:
        """Flush everything written so far to the disk, readable after a crash."""
        self._writer.flush()
        os.fsync(self._file.fileno())

    def close(self, custom_data: Mapping[str, str]) -> Path:
        """Finish the bag, with notes for its metadata, and return its path.

        Raises:
            OSError: The disk refuses the data; the bag stays unfinished.
        """
        self._writer.flush()
        information = self._information(custom_data)
        self._writer.add_metadata("rosbag2", {"serialized_metadata": _yaml(information)})
        self._writer.finish()
        self._file.close()
        text = _yaml({"rosbag2_bagfile_information": information})
        (self._written / "metadata.yaml").write_text(text, encoding="utf-8")
        for file in (*self._written.iterdir(), self._written):
            durable_files.sync(file)
        self._written.rename(self.path)
        self._parent.rmdir()
        durable_files.sync(self.path.parent)
        os.close(self._lock)
        return self.path

    def abandon(self) -> None:
        """Stop writing and leave the bag unfinished, as a kill would."""
        with suppress(OSError):  # a disk that refused data before refuses the rest, too
            self._file.close()
        os.close(self._lock)

    def _information(self, custom_data: Mapping[str, str]) -> dict[str, Any]:
        """Description of the bag, as rosbag2 of Jazzy writes it."""
        counts = self.counts

        def contents() -> dict[str, Any]:
            return {
                "starting_time": {"nanoseconds_since_epoch": self._first_ns},
                "duration": {"nanoseconds": max(self._last_ns - self._first_ns, 0)},
                "message_count": sum(counts.values()),
            }

        file = f"{self.path.name}.mcap"
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            "relative_file_paths": [file],
            **contents(),
            "topics_with_message_count": [
                {"topic_metadata": channel.metadata, "message_count": channel.count}
                for channel in self._channels.values()
            ],
            "compression_format": "",
            "compression_mode": "",
            "files": [{"path": file, **contents()}],
            "custom_data": dict(custom_data) or None,
            "ros_distro": "jazzy",
        }


@contextmanager
def new_bag(path: Path) -> Iterator[BagWriter]:
    """Begin a bag, which the block closes; it is removed if the block fails."""
    writer = BagWriter(path)
    try:
        yield writer
    except BaseException:
        writer.abandon()
        shutil.rmtree(unfinished(path), ignore_errors=True)
        raise


def _yaml(value: object) -> str:
    text: str = yaml.dump(value, Dumper=_DUMPER, sort_keys=False)
    return text
