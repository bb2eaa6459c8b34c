# SPDX-License-Identifier: Apache-2.0
"""Opened bags: metadata.yaml is read once, and every file is verified once."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePath
from typing import Any

from wam_power_ros import durable_files, plain_yaml
from wam_power_ros.arm_identity import ArmIdentity, from_json
from wam_power_ros.bags import files, layout
from wam_power_ros.bags.files import FILES, PACKED, Received, Topic


class Bag:
    """A rosbag2 bag, MCAP or SQLite, of any recorder; needs no closing.

    Attributes:
        path: Folder of the bag, or its only file.
        topics: Topics, in the order of their names.
    """

    def __init__(self, path: Path | str, *others: Path | str) -> None:
        """Open and verify a bag, or several that follow each other as one.

        Raises:
            ValueError: A path is not a bag, or is damaged, or unpacks to too much; or several bags
                are of different arms.
        """
        self.path = Path(path)
        self._files: list[files.McapFile | files.SqliteFile] = []
        notes: list[dict[str, str]] = []
        for each in map(Path, (path, *others)):
            durable_files.check_name(each)
            described = information(each)
            try:
                found = self._opened(each, described)
                described = described or found[0].information
                notes.append(layout.notes(described))
            except Exception as error:  # of any type, depending on the damage
                raise _unreadable(each, error) from error
            self._files += found
        self.notes, *_ = notes
        if len({noted.get("arm") for noted in notes}) > 1:
            raise ValueError(f"{', '.join(map(str, (path, *others)))} are of different arms")
        self._files.sort(key=lambda file: file.first)
        topics: dict[str, Topic] = {}
        for file in self._files:
            for name, topic in file.topics.items():
                files.add_topic(topics, name, topic)
        self.topics = dict(sorted(topics.items()))

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

    def messages(self, names: Iterable[str]) -> Iterator[Received]:
        """Topic, time of reception [ns] and bytes of each message on some topics.

        Raises:
            ValueError: The messages cannot be read, or unpack to too much.
        """
        names = set(names)
        try:
            for file in self._files:
                for name, stamp_ns, cdr in file.messages(names):
                    compression = "zstd" if cdr[:4] == files.ZSTD else ""
                    yield name, stamp_ns, files.unpacked(cdr, compression)
        except Exception as error:
            raise _unreadable(self.path, error) from error

    def type_of(self, name: str, *known: str) -> str:
        """Type of the messages on a topic; a ValueError if there is no topic of a known type."""
        if name not in self.topics:
            raise ValueError(f"{self.path}: no topic {name}; it has {sorted(self.topics)}")
        if (msgtype := self.topics[name].msgtype) not in known:
            raise ValueError(f"{self.path}: {name} is of type {msgtype}, not {' or '.join(known)}")
        return msgtype

    def _opened(
        self, path: Path, described: Mapping[str, Any]
    ) -> list[files.McapFile | files.SqliteFile]:
        """Files of a bag, verified, whose metadata.yaml is that description; empty without."""
        paths = [path]
        if described:
            names = [PurePath(str(name)).name for name in described["relative_file_paths"]]
            paths = [path / name for name in names]
        folder = None
        for number, file in enumerate(paths):
            if file.suffix == PACKED:
                if folder is None:
                    folder = Path(tempfile.mkdtemp())  # removed with this value
                    weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
                paths[number] = files.unpacked_file(file, folder)
        found = [files.opened(file) for file in paths]
        for file, name in zip(found, paths, strict=True):
            if described and file.sealed and file.information not in ({}, described):
                keys = file.information.keys() | described.keys()
                differ = [k for k in keys if file.information.get(k) != described.get(k)]
                raise ValueError(
                    "metadata.yaml was changed after the recording: "
                    f"{', '.join(sorted(differ))} differ from the copy in {name.name}"
                )
        return found


def _unreadable(path: Path, error: Exception) -> ValueError:
    return ValueError(f"{path} cannot be read as a bag: {str(error) or type(error).__name__}")


def information(path: Path) -> Mapping[str, Any]:
    """Description of a bag in its metadata.yaml; empty for a lone file.

    Raises:
        ValueError: The path is not a bag, or the description does not name its files.
    """
    if not path.exists():
        if layout.unfinished(path).exists():
            raise ValueError(f"{path} was never closed; recover it first: wam-power recover {path}")
        raise ValueError(f"{path} is not a bag: there is no such folder")
    if path.is_file() and path.name.removesuffix(PACKED).endswith(FILES):
        return {}
    if path.suffix == ".bag":
        to = path.with_suffix("")
        raise ValueError(f"{path} is a bag of ROS 1: rosbags-convert --src {path} --dst {to}")
    file = path / "metadata.yaml"
    if not file.is_file():
        names = sorted(str(each) for each in path.glob("*") if each.name.endswith(FILES))
        remedy = f"all of them: wam-power bags import {' '.join(names)}" if names[1:] else ""
        raise ValueError(
            f"{path} is not a bag: it has no metadata.yaml; name its .mcap or .db3 file instead, "
            f"{remedy or f'or, if an .mcap file is damaged: wam-power recover {path}'}"
        )
    try:
        read = plain_yaml.read(file)
    except ValueError as error:
        raise _unreadable(path, error) from error
    found = read.get("rosbag2_bagfile_information") if isinstance(read, dict) else None
    if not isinstance(found, dict) or not isinstance(found.get("relative_file_paths"), list):
        raise _unreadable(path, ValueError("metadata.yaml has no relative_file_paths"))
    return found
