# SPDX-License-Identifier: Apache-2.0
"""Opened bags: metadata.yaml is read once, and every file is verified once."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.interfaces import Qos, QosDurability
from rosbags.rosbag2 import Reader

from wam_power_ros import durable_files, plain_yaml
from wam_power_ros.arm_identity import ArmIdentity, from_json
from wam_power_ros.bags import integrity, layout

FILES = (".mcap", ".db3")  # what a bag may consist of


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        msgtype: Message type, such as "std_msgs/msg/String".
        offered: QoS of its publishers.
        counted: Number of its messages according to the recorder.
    """

    msgtype: str
    offered: tuple[Qos, ...]
    counted: int = 0

    @property
    def latched(self) -> bool:
        """Whether late subscribers receive the last messages."""
        return bool(self.offered) and all(
            qos.durability == QosDurability.TRANSIENT_LOCAL for qos in self.offered
        )


class Bag:
    """A rosbag2 bag, MCAP or SQLite, of any recorder; needs no closing.

    Attributes:
        path: Folder of the bag, or its only file.
        topics: Topics, in the order of their names.
        notes: Notes of the recorder.
    """

    def __init__(self, path: Path | str) -> None:
        """Open and verify a bag.

        Raises:
            ValueError: `path` is not a bag, is damaged, unpacks to too much, or a topic has
                several types.
        """
        self.path = Path(path)
        durable_files.check_name(self.path)
        metadata = _metadata(self.path)
        try:
            if metadata is None:
                file = integrity.unpacked(self.path, self._folder)
                metadata = _described(file)
            else:
                file = self.path
            information = integrity.information(metadata)
            self.notes = layout.notes(information)
            self._files = integrity.verified(file, information, self._folder)
            self.topics = _topics(information, self._files)
        except Exception as error:  # of any type, depending on the damage
            raise self._unreadable(error) from error

    @property
    def arm(self) -> ArmIdentity | None:
        """Arm that the recorder noted; None if it did not, as other recorders.

        Raises:
            ValueError: The note is malformed.
        """
        try:
            return from_json(self.notes.get("arm", ""))
        except ValueError as error:
            raise ValueError(f"{self.path}: {error}") from None

    @property
    def kind(self) -> str:
        """Kind of the recording in our recorder's start event, else the first part of its name."""
        first = next((cdr for *_, cdr in self.messages([layout.EVENT])), b"")
        event = layout.event(first)
        noted = str(event.get("reason", "")) if event.get("event") == "start" else ""
        return noted or self.path.resolve().name.partition("_")[0]

    def messages(self, names: Iterable[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of reception [ns] and bytes of each message on some topics.

        Raises:
            ValueError: The messages cannot be read, or unpack to too much.
        """
        names = set(names)
        budget = integrity.Budget(self.path, sum(file.stat().st_size for file in self._files))
        try:
            for file in self._files:
                with Reader(file) as reader:
                    _expect_all(reader)
                    kept = [item for item in reader.connections if item.topic in names]
                    for item, stamp_ns, cdr in reader.messages(kept) if kept else ():
                        if cdr[:4] == integrity.ZSTD:  # unpacked here, with a limit
                            where = f"{self.path}: a message on {item.topic}"
                            cdr = integrity.unpack(cdr, "zstd", integrity.UNPACKED_MAX, where)
                        budget.spend(len(cdr))
                        yield item.topic, stamp_ns, cdr
        except Exception as error:
            raise self._unreadable(error) from error

    def check_counts(self) -> None:
        """Read all messages and compare their number by topic with what the recorder counted.

        Raises:
            ValueError: They cannot be read, or fewer are there.
        """
        found = Counter(name for name, _, _ in self.messages(self.topics))
        for name, topic in self.topics.items():
            if found[name] < topic.counted:
                raise ValueError(
                    f"{self.path}: {found[name]} of {topic.counted} messages on {name} are there"
                )

    def _folder(self) -> Path:
        """A folder for unpacked files, removed with this value."""
        folder = tempfile.mkdtemp()
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        return Path(folder)

    def _unreadable(self, error: Exception) -> ValueError:
        return ValueError(f"{self.path} cannot be read as a bag: {error}")


def _metadata(path: Path) -> object:
    """Contents of metadata.yaml, None for files without; ValueError if `path` is not a bag."""
    if not path.exists():
        if layout.unfinished(path).exists():
            raise ValueError(f"{path} was never closed; recover it first: wam-power recover {path}")
        raise ValueError(f"{path} is not a bag: there is no such folder")
    if path.is_file() and path.name.removesuffix(integrity.PACKED).endswith(FILES):
        return None
    if path.suffix == ".bag":
        to = path.with_suffix("")
        raise ValueError(f"{path} is a bag of ROS 1: rosbags-convert --src {path} --dst {to}")
    file = path / "metadata.yaml"
    if not file.is_file():
        files = sorted(str(each) for each in path.glob("*") if each.name.endswith(FILES))
        remedy = f"all of them: wam-power bags merge {' '.join(files)}" if files[1:] else ""
        raise ValueError(
            f"{path} is not a bag: it has no metadata.yaml; name its .mcap or .db3 file instead, "
            f"{remedy or f'or, if an .mcap file is damaged: wam-power recover {path}'}"
        )
    return plain_yaml.read(file)


def _described(file: Path) -> dict[str, Any]:
    """Description of a lone file, as metadata.yaml would give it, from the file itself."""
    noted = integrity.noted(file) if file.suffix == ".mcap" else {}
    described = {
        "relative_file_paths": [file.name],
        "topics_with_message_count": _counts(file),
        "custom_data": noted.get("custom_data"),
    }
    return {"rosbag2_bagfile_information": described}


def _counts(file: Path) -> list[dict[str, Any]]:
    """Topics of a file and the numbers of their messages, as metadata.yaml would give them."""
    with Reader(file) as reader:
        return [
            {
                "topic_metadata": {
                    "name": item.topic,
                    "type": item.msgtype,
                    "serialization_format": getattr(item.ext, "serialization_format", "cdr"),
                    "offered_qos_profiles": layout.described_qos(
                        getattr(item.ext, "offered_qos_profiles", ())
                    ),
                },
                "message_count": item.msgcount,
            }
            for item in reader.connections
        ]


def _expect_all(reader: Reader) -> None:
    """Make a reader look for each topic in each chunk.

    It skips chunks in which a topic has no message according to their indexes of messages. These
    are optional in MCAP, and rosbag2 leaves them out with `noMessageIndex`.
    """
    for chunk in getattr(reader.storage, "chunks", ()):
        for item in reader.connections:
            chunk.channel_count.setdefault(item.id, 1)


def _topics(information: Mapping[str, Any], files: Iterable[Path]) -> dict[str, Topic]:
    """Topics of a bag in the order of their names: those of its files that no metadata lists, too.

    A recorder that was killed, and some conversions, leave a list that is not complete.
    """
    found: dict[str, Topic] = {}
    listed = [*information["topics_with_message_count"]]
    names = {counts["topic_metadata"]["name"] for counts in listed}
    for file in files:
        listed += [each for each in _counts(file) if each["topic_metadata"]["name"] not in names]
    for counts in sorted(listed, key=lambda counts: counts["topic_metadata"]["name"]):
        item = counts["topic_metadata"]
        name, msgtype = item["name"], item["type"]
        known = found.get(name, Topic(msgtype, ()))
        if known.msgtype != msgtype:
            raise ValueError(f"{name} has types {known.msgtype} and {msgtype}")
        if item["serialization_format"] != "cdr":
            raise ValueError(f"{name} is not serialized as cdr: {item['serialization_format']}")
        offered = layout.parsed_qos(item.get("offered_qos_profiles"))
        counted = known.counted + int(counts.get("message_count") or 0)
        found[name] = Topic(msgtype, (*known.offered, *offered), counted)
    return found
