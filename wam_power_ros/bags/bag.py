# SPDX-License-Identifier: Apache-2.0
"""Opened bags: metadata.yaml is read once, and every file is verified once."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.interfaces import Qos, QosDurability
from rosbags.rosbag2 import Reader

from wam_power_ros import plain_yaml
from wam_power_ros.arm_identity import ArmIdentity, from_json
from wam_power_ros.bags import integrity, layout


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        msgtype: Message type, such as "std_msgs/msg/String".
        offered: QoS of its publishers.
    """

    msgtype: str
    offered: tuple[Qos, ...]

    @property
    def latched(self) -> bool:
        """Whether late subscribers receive the last messages."""
        return bool(self.offered) and all(
            qos.durability == QosDurability.TRANSIENT_LOCAL for qos in self.offered
        )


class Bag:
    """A rosbag2 bag, MCAP or SQLite, of any recorder; needs no closing.

    Attributes:
        path: Folder of the bag.
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
        metadata = _metadata(self.path)
        self.notes = layout.notes(metadata)
        try:
            information = integrity.information(metadata)
            self.topics = _topics(information)
            self._packed_messages = str(information.get("compression_mode")).lower() == "message"
            self._files = integrity.verified(self.path, information, self._folder)
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
                    kept = [item for item in reader.connections if item.topic in names]
                    for item, stamp_ns, cdr in reader.messages(kept) if kept else ():
                        if self._packed_messages:  # unpacked here, with a limit
                            where = f"{self.path}: a message on {item.topic}"
                            cdr = integrity.unpack(cdr, "zstd", integrity.UNPACKED_MAX, where)
                        budget.spend(len(cdr))
                        yield item.topic, stamp_ns, cdr
        except Exception as error:
            raise self._unreadable(error) from error

    def _folder(self) -> Path:
        """A folder for unpacked files, removed with this value."""
        folder = tempfile.mkdtemp()
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        return Path(folder)

    def _unreadable(self, error: Exception) -> ValueError:
        return ValueError(f"{self.path} cannot be read as a bag: {error}")


def _metadata(path: Path) -> object:
    """Contents of metadata.yaml; ValueError if `path` is not a bag."""
    if not path.exists():
        if layout.unfinished(path).exists():
            raise ValueError(f"{path} was never closed; recover it first: wam-power recover {path}")
        raise ValueError(f"{path} is not a bag: there is no such folder")
    file = path / "metadata.yaml"
    if not file.is_file():
        raise ValueError(
            f"{path} is not a bag: it has no metadata.yaml; if it has an .mcap file: "
            f"wam-power recover {path}"
        )
    return plain_yaml.read(file)


def _topics(information: Mapping[str, Any]) -> dict[str, Topic]:
    """Topics in the metadata of a bag, in the order of their names."""
    found: dict[str, Topic] = {}
    described = [item["topic_metadata"] for item in information["topics_with_message_count"]]
    for item in sorted(described, key=lambda item: item["name"]):
        name, msgtype = item["name"], item["type"]
        known = found.get(name, Topic(msgtype, ()))
        if known.msgtype != msgtype:
            raise ValueError(f"{name} has types {known.msgtype} and {msgtype}")
        if item["serialization_format"] != "cdr":
            raise ValueError(f"{name} is not serialized as cdr: {item['serialization_format']}")
        offered = layout.parsed_qos(item.get("offered_qos_profiles"))
        found[name] = Topic(msgtype, (*known.offered, *offered))
    return found
