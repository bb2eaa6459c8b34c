# SPDX-License-Identifier: Apache-2.0
"""Recovery of bags damaged by a kill, a full disk or an incomplete copy.

An MCAP file is a sequence of records. Every complete message, even of a truncated chunk, is copied
into a new bag; a chunk that does not match its checksum is skipped as a whole and reported.
https://mcap.dev/spec
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, InvalidMagic
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from wam_power_ros import plain_yaml
from wam_power_ros.bags import files, layout
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import unfinished
from wam_power_ros.bags.writer import BagWriter, new_bag


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
    damaged = _files(path)
    bag = path.with_suffix("") if path.is_file() else path
    with new_bag(bag.with_name(bag.name + "_recovered")) as writer:
        copy = _Copy(writer)
        for file in damaged:
            copy.file(file)
        if (metadata := damaged[0].with_name("metadata.yaml")).is_file():
            with suppress(ValueError):  # damaged as well
                copy.notes |= layout.notes(plain_yaml.read(metadata))
        made = writer.close(copy.notes | {"recovered": json.dumps(True)})
    for name, topic in Bag(made).topics.items():
        if topic.found != (count := writer.counts[name]):
            raise ValueError(f"{made}: {topic.found} of {count} messages on {name} are there")
    return Recovered(made, writer.counts, copy.left_out)


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
    found = sorted(path.glob("*.mcap"), key=lambda file: (len(file.name), file.name))
    if not found:
        others = sorted(file.name for file in path.glob("*")) if path.is_dir() else []
        raise ValueError(f"{path} has no .mcap file to recover; it has {others or 'no files'}")
    return found


@dataclass
class _Copy:
    """Copies records into a new bag."""

    writer: BagWriter
    notes: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)

    def file(self, file: Path) -> None:
        """Copy the records of one file."""
        schemas: dict[int, str] = {}  # ids of schemas and channels are local to a file
        topics: dict[int, str] = {}  # those that are copied
        for record in self._records(file):
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel) and record.id not in topics:
                if self._add(record, schemas.get(record.schema_id, "no type")):
                    topics[record.id] = record.topic
            elif isinstance(record, Message) and (topic := topics.get(record.channel_id)):
                self.writer.write(topic, record.log_time, record.data)
                if topic == layout.EVENT and not self.notes:
                    self.notes = layout.texts(layout.event(record.data).get("notes"))
            elif isinstance(record, Metadata) and record.name == "rosbag2":  # of a closed bag
                text = record.metadata.get("serialized_metadata", "")
                with suppress(ValueError):
                    self.notes |= layout.notes(plain_yaml.parse(text.encode(), "metadata"))

    def _add(self, channel: Channel, kind: str) -> bool:
        """Add the topic of a channel, unless a file before did; whether it can be copied."""
        if channel.topic not in self.writer.counts:
            offered = layout.parsed_qos(channel.metadata.get("offered_qos_profiles"))
            try:
                self.writer.add(channel.topic, kind, offered)
            except ValueError as error:
                self.left_out[channel.topic] = str(error)
                return False
        return True

    def _records(self, path: Path) -> Iterator[McapRecord]:
        """Complete records of a file, those in chunks included; what is damaged is noted."""
        with path.open("rb") as file:
            limit = files.UNPACKED_MAX
            records = StreamReader(file, emit_chunks=True, record_size_limit=limit).records
            while True:
                begins = file.tell()
                try:
                    record = next(records, None)
                except EndOfFile:
                    yield from _truncated(file, begins)
                    return
                except Exception as error:  # of any type, depending on the damage
                    if isinstance(error, InvalidMagic) and begins == 0:
                        raise ValueError(f"{path} is not an MCAP file") from None
                    self.left_out[f"{path.name}, everything from byte {begins} on"] = "damaged"
                    return
                if record is None:
                    return
                if not isinstance(record, Chunk):
                    yield record
                    continue
                try:
                    contents = files.contents(record)
                except Exception:  # of the checksum, or of the library of its compression
                    self.left_out[f"{path.name}, chunk at byte {begins}"] = "damaged"
                else:
                    yield from contents


def _truncated(file: BinaryIO, begins: int) -> Iterator[McapRecord]:
    """Complete records of a chunk that the end of the file cuts off, which cannot be checked."""
    file.seek(begins)
    with suppress(Exception):  # at the end; or as the library of its compression raises
        stream = ReadDataStream(file)
        opcode, _ = stream.read1(), stream.read8()
        if opcode == Opcode.CHUNK:
            chunk = Chunk.read(stream)
            raw = files.unpacked(chunk.data, chunk.compression)
            yield from StreamReader(BytesIO(raw), skip_magic=True).records
