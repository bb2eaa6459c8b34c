# SPDX-License-Identifier: Apache-2.0
"""Recovery of bags damaged by a kill, a full disk or an incomplete copy.

An MCAP file is a sequence of records. Every complete message, even of a truncated chunk, is copied
into a new bag; a chunk that does not match its checksum is skipped as a whole and reported.
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
from dataclasses import dataclass, field
from pathlib import Path

from rosbags.interfaces import Qos

from wam_power_ros import plain_yaml
from wam_power_ros.bags import layout, reader
from wam_power_ros.bags.integrity import (
    CHANNEL,
    CHUNK,
    CHUNK_CRC_OFFSET,
    CHUNK_HEADER,
    MAGIC,
    MESSAGE,
    METADATA,
    RECORD_HEADER,
    SCHEMA,
)
from wam_power_ros.bags.layout import unfinished
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.durable_files import check_regular

PROFILES = "offered_qos_profiles"
# rosbag2's names of the policies that are not the default; before Jazzy numbers
BEST_EFFORT = {"best_effort", 2}
LATCHED = {"transient_local", 1}


@dataclass(frozen=True)
class Recovered:
    """Result of a recovery.

    Attributes:
        path: Folder of the new bag; the damaged one is not changed.
        messages: Number of messages in it, by topic.
        left_out: Reason for each topic or damaged part of a file that is not in it.
    """

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
        ValueError: There is no MCAP file, or it is still being written, or it is compressed.
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
            copy.notes |= _notes(metadata)
        state_topic = copy.notes.get("state_topic", layout.STATES)
        notes = copy.notes | writer.completeness(state_topic) | {"recovered": json.dumps(True)}
        made = writer.close(notes)
    except BaseException:
        writer.abandon()
        shutil.rmtree(unfinished(writer.path), ignore_errors=True)
        raise
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


def _notes(file: Path) -> dict[str, str]:
    try:
        return reader.custom_data(plain_yaml.read(file))
    except ValueError:
        return {}  # damaged as well


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
        check_regular(file)
        if file.stat().st_size <= len(MAGIC):
            return
        damaged: list[str] = []
        with file.open("rb") as opened, mmap.mmap(opened.fileno(), 0, prot=mmap.PROT_READ) as data:
            if data[: len(MAGIC)] != MAGIC:
                raise ValueError(f"{file} is not an MCAP file: it begins {data[:8]!r}")
            try:
                for opcode, body in _records(data, len(MAGIC), damaged):
                    self._record(opcode, body)
            except (struct.error, UnicodeDecodeError, KeyError):
                damaged.append("everything after a damaged record")
            except _CompressedError as error:
                raise ValueError(
                    f"{file} has chunks compressed with {error}; recover it with `mcap recover`"
                ) from None
            self.left_out |= {f"{file.name}, {part}": "damaged" for part in damaged}

    def _record(self, opcode: int, body: bytes) -> None:
        if opcode == SCHEMA:
            (number,) = struct.unpack_from("<H", body)
            self._schemas[number] = _text(body, 2)[0]
        elif opcode == CHANNEL:
            self._channel(body)
        elif opcode == MESSAGE:
            channel, _, stamp_ns = struct.unpack_from("<HIQ", body)
            topic = self._topics[channel]
            if topic is not None:
                cdr = body[22:]
                self.writer.write(topic, stamp_ns, cdr)
                if topic == layout.EVENT and not self.notes:
                    self.notes = reader.texts(layout.event(cdr).get("notes"))
        elif opcode == METADATA and _text(body, 0)[0] == "rosbag2":  # of a closed bag
            for _, text in _map(body, _text(body, 0)[1]):
                self.notes |= _metadata_notes(text)

    def _channel(self, body: bytes) -> None:
        channel, schema = struct.unpack_from("<HH", body)
        if channel in self._topics:
            return
        topic, at = _text(body, 4)
        _, at = _text(body, at)  # the encoding
        offered = _profiles(dict(_map(body, at)).get(PROFILES, ""))
        self._topics[channel] = topic
        if topic in self.writer.counts:  # added by an earlier file of the bag
            return
        try:
            self.writer.add(topic, self._schemas[schema], offered)
        except ValueError as error:
            self._topics[channel] = None
            self.left_out[topic] = str(error)


class _CompressedError(Exception):
    """A chunk is compressed; the message names the algorithm."""


def _records(data: bytes | mmap.mmap, at: int, damaged: list[str]) -> Iterator[tuple[int, bytes]]:
    """Complete MCAP records from an offset on, including those in chunks; data may be truncated.

    A chunk that does not match its checksum or its declared size is added to `damaged`. A chunk
    truncated by the end of the data cannot be checked.
    """
    while at + RECORD_HEADER.size <= len(data):
        opcode, size = RECORD_HEADER.unpack_from(data, at)
        begin = at + RECORD_HEADER.size
        where, at = f"chunk at byte {at}", begin + size
        body = data[begin:at]
        if opcode == CHUNK:  # perhaps truncated
            compression, end = _text(body, CHUNK_HEADER.size)
            if compression:
                raise _CompressedError(compression)
            (crc,) = struct.unpack_from("<I", body, CHUNK_CRC_OFFSET)
            (packed,) = struct.unpack_from("<Q", body, end)
            records = body[end + 8 : end + 8 + packed]
            complete = len(records) == packed
            if crc and (zlib.crc32(records) != crc if complete else len(body) == size):
                damaged.append(where)
            else:
                yield from _records(body, end + 8, damaged)
        elif len(body) == size:
            yield opcode, body


def _text(body: bytes, at: int) -> tuple[str, int]:
    """String at an offset, and the offset after it."""
    (size,) = struct.unpack_from("<I", body, at)
    end = at + 4 + size
    if end > len(body):
        raise struct.error(f"string of {size} bytes at {at} ends beyond its record")
    return body[at + 4 : end].decode(), end


def _map(body: bytes, at: int) -> Iterator[tuple[str, str]]:
    """Keys and values of a map of strings at an offset."""
    (size,) = struct.unpack_from("<I", body, at)
    at, end = at + 4, at + 4 + size
    while at < min(end, len(body)):
        key, at = _text(body, at)
        value, at = _text(body, at)
        yield key, value


def _metadata_notes(text: str) -> dict[str, str]:
    try:
        return reader.custom_data(plain_yaml.parse(text.encode(), "the metadata record"))
    except ValueError:
        return {}


def _profiles(text: str) -> list[Qos]:
    """QoS profiles in a channel's metadata; empty when they cannot be parsed."""
    try:
        return [
            layout.qos(
                qos["reliability"] not in BEST_EFFORT,
                qos["durability"] in LATCHED,
                int(qos["depth"]),
            )
            for qos in plain_yaml.parse(text.encode(), PROFILES) or []
        ]
    except (ValueError, TypeError, KeyError):
        return []
