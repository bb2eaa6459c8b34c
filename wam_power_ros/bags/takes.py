# SPDX-License-Identifier: Apache-2.0
"""Takes: recordings in folders, and a summary of each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wam_power_ros.bags import layout, reader
from wam_power_ros.bags.gaps import GapCounter
from wam_power_ros.bags.quality import Remark
from wam_power_ros.bags.series import TRASH
from wam_power_ros.bags.writer import has_header, header_stamp

FOLDERS = ("bags", "demonstrations", "replays", "sessions")  # searched by default


@dataclass(frozen=True)
class Take:
    """A recording.

    Attributes:
        path: Folder of the bag.
        kind: Stem of a task, "rollout" or "replay", see `kind_of`.
        counts: Number of messages by topic.
        missing: Number of messages missing according to the stamps, by topic.
        ended: Reason for the end, such as `layout.STOP_REQUESTED`; empty if unknown.
        stamps: Stamps of the joint states [ns]. Shape (M,).
        q: Joint angles [rad]. Shape (M, n).
        remarks: What was left out or unwrapped in reading them.
    """

    path: Path
    kind: str
    counts: dict[str, int]
    missing: dict[str, int]
    ended: str
    stamps: np.ndarray
    q: np.ndarray
    remarks: tuple[Remark, ...]

    @property
    def duration(self) -> float:
        """Time from the first to the last joint state [s]."""
        return float(self.stamps[-1] - self.stamps[0]) * 1e-9


def find(places: Iterable[Path]) -> list[Path]:
    """Bags in some folders and below, closed or not, sorted by path; a place may be a bag."""
    found = set()
    for place in places:
        for path in (place, *place.rglob("*")) if place.is_dir() else ():
            if TRASH in path.parts:
                continue
            if path.name.endswith(layout.UNFINISHED):
                found.add(path.with_name(path.name.removesuffix(layout.UNFINISHED)))
            elif (path / "metadata.yaml").is_file() and not (
                path.parent.name.endswith(layout.UNFINISHED)
            ):
                found.add(path)
    return sorted(found, key=lambda path: (path.parent, path.name))


def kind_of(path: Path) -> str:
    """Kind of a recording in the start event of our recorder, else the first part of its name.

    Raises:
        ValueError: `path` is not a bag, or is damaged.
    """
    first = layout.event(next((cdr for _, _, cdr in reader.messages(path, [layout.EVENT])), b""))
    noted = str(first.get("reason", "")) if first.get("event") == "start" else ""
    return noted or path.resolve().name.partition("_")[0]


def read(path: Path, joint_names: Sequence[str]) -> Take:
    """Read a take.

    Raises:
        ValueError: As `reader.read_states`.
    """
    states = reader.read_states(path, joint_names)
    topics = reader.topics(path)
    counts = dict.fromkeys(topics, 0)
    gaps: dict[str, GapCounter] = {}
    ended = ""
    for name, _, cdr in reader.messages(path, topics):
        counts[name] += 1
        if name == layout.EVENT and (event := layout.event(cdr)).get("event") == "stop":
            ended = str(event.get("reason", ended))
        msgtype = topics[name].msgtype
        if msgtype in layout.TYPES.fielddefs and has_header(msgtype):
            gaps.setdefault(name, GapCounter()).add(header_stamp(cdr))
    missing = {name: counter.gaps().missing for name, counter in gaps.items() if counts[name] > 2}
    kind = kind_of(path)
    return Take(path, kind, counts, missing, ended, states.stamps, states.q, states.remarks)
