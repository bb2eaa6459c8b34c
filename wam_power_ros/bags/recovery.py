# SPDX-License-Identifier: Apache-2.0
"""Recovery of bags damaged by a kill, a full disk or an incomplete copy.

An MCAP file is a sequence of records. Every complete message, even of a truncated chunk, is copied
into a new bag; a chunk that does not match its checksum is skipped as a whole and reported.
https://mcap.dev/spec
"""

from __future__ import annotations

import fcntl
import json
import mmap
import os
import shutil
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Metadata, Schema

from wam_power_ros import plain_yaml
from wam_power_ros.bags import files, layout
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import unfinished
from wam_power_ros.bags.writer import BagWriter

MAGIC = b"\x89MCAP0\r\n"
HEADER = struct.Struct("<BQ")  # opcode and size of a record
MESSAGE_HEADER = struct.Struct("<HIQQ")  # channel, number, times of reception and publication [ns]

R = TypeVar("R", bound=McapRecord)


@dataclass(frozen=True)
class Recovered:
    """The new bag, its messages by topic, and why a topic or part of a file is not in it."""

    path: Path
    messages: Mapping[str, int]
    left_out: Mapping[str, str]

    def __str__(self) -> str:
        """Summary for a terminal."""
        lines = [f"{self.path}: {sum(self.messages.values())} messages"]
        lines += [f"  {count:8} {topic}" for topic, count in self.messages.items()]
        lines += [f"  left out: {topic}, {why}" for topic, why in self.left_out.items()]
        return "\n".join(lines)


def recover(path: Path) -> Recovered:
    """Write the complete messages of a damaged bag to a new bag `<name>_recovered`.

    Args:
        path: Folder of the bag, closed or not, with or without metadata; or its .mcap file.

    Raises:
        ValueError: There is no MCAP file, or it is still being written, or compressed as a whole.
        FileExistsError: There is a recovered bag already.
        OSError: The new bag cannot be written.
    """
    if path.name.endswith(layout.UNFINISHED):
        path = path.with_name(path.name.removesuffix(layout.UNFINISHED))
    files = _files(path)
    bag = path.with_suffix("") if path.is_file() else path
    writer = BagWriter(bag.with_name(bag.name + "_recovered"))
    try:
        copy = _Copy(writer)
        for file in files:
            copy.file(file)
        if (metadata := files[0].with_name("metadata.yaml")).is_file():
            with suppress(ValueError):  # damaged as well
                copy.notes |= layout.notes(plain_yaml.read(metadata))
        notes = copy.notes | writer.completeness(copy.notes) | {"recovered": json.dumps(True)}
        made = writer.close(notes)
    except BaseException:
        writer.abandon()
        shutil.rmtree(unfinished(writer.path), ignore_errors=True)
        raise
    Bag(made).check_counts()
    return Recovered(made, dict(writer.counts), copy.left_out)


def _files(path: Path) -> list[Path]:
    """MCAP files of a bag, in order; ValueError if there is none or the bag is being written."""
    if path.is_file():
        return [path]
    parent = unfinished(path)
    if not path.exists() and parent.is_dir():
        handle = os.open(parent, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ValueError(f"{path} is still being written") from None
        finally:
            os.close(handle)
        path = parent / path.name
    files = sorted(path.glob("*.mcap"), key=lambda file: (len(file.name), file.name))
    if not files:
        others = sorted(file.name for file in path.glob("*")) if path.is_dir() else []
        raise ValueError(f"{path} has no .mcap file to recover; it has {others or 'no files'}")
    return files


@dataclass
class _Copy:
    """Copies records into a new bag."""

    writer: BagWriter
    notes: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    _schemas: dict[int, str] = field(default_factory=dict)
    _topics: dict[int, str | None] = field(default_factory=dict)  # None: not copied

    def file(self, file: Path) -> None:
        """Copy the records of one file."""
        self._schemas.clear()  # ids of schemas and channels are local to a file
        self._topics.clear()
        if file.stat().st_size <= len(MAGIC):
            return
        damaged: list[str] = []
        with (
            file.open("rb") as opened,
            mmap.mmap(opened.fileno(), 0, prot=mmap.PROT_READ) as data,
        ):
            if data[: len(MAGIC)] != MAGIC:
                raise ValueError(f"{file} is not an MCAP file: it begins {data[:8]!r}")
            try:
                for opcode, body in _records(data, len(MAGIC), damaged):
                    self._record(opcode, body)
            except (ValueError, struct.error, KeyError):
                damaged.append("everything after a damaged record")
        self.left_out |= {f"{file.name}, {part}": "damaged" for part in damaged}

    def _record(self, opcode: int, body: bytes) -> None:
        if opcode == Opcode.SCHEMA:
            schema = _parsed(Schema, body)
            self._schemas[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            self._channel(_parsed(Channel, body))
        elif opcode == Opcode.MESSAGE:
            channel, _, stamp_ns, _ = MESSAGE_HEADER.unpack_from(body)
            topic = self._topics[channel]
            if topic is not None:
                cdr = body[MESSAGE_HEADER.size :]
                self.writer.write(topic, stamp_ns, cdr)
                if topic == layout.EVENT and not self.notes:
                    self.notes = layout.texts(layout.event(cdr).get("notes"))
        elif opcode == Opcode.METADATA:
            metadata = _parsed(Metadata, body)
            if metadata.name == "rosbag2":  # of a closed bag
                text = metadata.metadata.get("serialized_metadata", "")
                with suppress(ValueError):
                    self.notes |= layout.notes(plain_yaml.parse(text.encode(), "metadata"))

    def _channel(self, channel: Channel) -> None:
        if channel.id in self._topics:
            return
        topic = self._topics[channel.id] = channel.topic
        if topic in self.writer.counts:  # added by an earlier file of the bag
            return
        offered = layout.parsed_qos(channel.metadata.get("offered_qos_profiles"))
        try:
            self.writer.add(topic, self._schemas[channel.schema_id], offered)
        except ValueError as error:
            self._topics[channel.id] = None
            self.left_out[topic] = str(error)


def _parsed(kind: type[R], body: bytes) -> R:
    """Record of a kind; of a truncated body, its last field may be truncated."""
    try:
        record: R = kind.read(ReadDataStream(BytesIO(body)))  # type: ignore[attr-defined]
    except (McapError, OverflowError) as error:
        raise ValueError(f"{kind.__name__} of {len(body)} bytes is damaged: {error}") from None
    return record


def _records(data: bytes | mmap.mmap, at: int, damaged: list[str]) -> Iterator[tuple[int, bytes]]:
    """Complete MCAP records from an offset on, including those in chunks; data may be truncated.

    A chunk that does not match its checksum, or cannot be unpacked, is added to `damaged`. A chunk
    truncated by the end of the data cannot be checked.
    """
    while at + HEADER.size <= len(data):
        opcode, size = HEADER.unpack_from(data, at)
        begins, at = at, at + HEADER.size + size
        body, complete = data[begins + HEADER.size : at], at <= len(data)
        if opcode == Opcode.CHUNK:
            chunk = _parsed(Chunk, body)
            try:
                raw = files.unpacked(chunk.data, chunk.compression)
            except Exception:  # of the library of its compression
                raw = b""
            crc = chunk.uncompressed_crc
            if not raw or (complete and crc and crc != zlib.crc32(raw)):
                damaged.append(f"chunk at byte {begins}")
            else:
                yield from _records(raw, 0, damaged)
        elif complete:
            yield opcode, body
