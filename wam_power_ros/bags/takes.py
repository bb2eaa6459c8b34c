# SPDX-License-Identifier: Apache-2.0
"""Takes: recordings in folders, and a summary of each."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from wam_power_ros.bags import layout
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import STATES
from wam_power_ros.bags.quality import gaps
from wam_power_ros.bags.reader import States, read_states
from wam_power_ros.bags.series import TRASH
from wam_power_ros.bags.writer import header_stamp

FOLDERS = ("bags", "demonstrations", "replays", "sessions")  # searched by default


@dataclass(frozen=True)
class Take:
    """A bag, and a summary of its messages."""

    bag: Bag
    states: States
    counts: dict[str, int]  # number of messages by topic
    missing: dict[str, int]  # number of messages missing according to the stamps, by topic
    ended: str  # reason for the end, such as `layout.STOP_REQUESTED`; empty if unknown

    @property
    def duration(self) -> float:
        """Time from the first to the last joint state [s]."""
        return float(self.states.stamps[-1] - self.states.stamps[0]) * 1e-9


def is_bag(path: Path) -> bool:
    """Whether a folder is a bag."""
    return (path / "metadata.yaml").is_file()


def find(places: Iterable[Path]) -> list[Path]:
    """Bags in some folders and below, closed or not, sorted by path; a place may be a bag."""
    found = set()
    for place in places:
        if is_bag(place):
            found.add(place)
        for folder, names, _ in os.walk(place):
            names[:] = [name for name in names if name != TRASH]
            for path in (Path(folder, name) for name in names):
                if path.name.endswith(layout.UNFINISHED):
                    found.add(path.with_name(path.name.removesuffix(layout.UNFINISHED)))
                elif not path.parent.name.endswith(layout.UNFINISHED) and is_bag(path):
                    found.add(path)
    return sorted(found, key=lambda path: (path.parent, path.name))


def read(bag: Bag, joint_names: Sequence[str]) -> Take:
    """Summary of a take."""
    states = read_states(bag, joint_names)
    counts = {name: topic.found for name, topic in bag.topics.items()}
    stamped = [name for name, topic in bag.topics.items() if _has_header(topic.msgtype)]
    stamps: dict[str, list[int]] = {}
    for name, _, cdr in bag.messages(stamped):
        stamps.setdefault(name, []).append(header_stamp(cdr))
    stamps[bag.notes.get("state_topic", STATES)] = states.stamps.tolist()  # of the arm alone
    ended = ""
    for _, _, cdr in bag.messages([layout.EVENT]):
        if (event := layout.event(cdr)).get("event") == "stop":
            ended = str(event.get("reason", ended))
    missing = {name: gaps(of).missing for name, of in stamps.items() if counts[name] > 2}
    return Take(bag, states, counts, missing, ended)


def _has_header(msgtype: str) -> bool:
    """Whether messages of a type, which may be unknown, begin with a std_msgs/Header."""
    _, fields = layout.TYPES.fielddefs.get(msgtype, ((), ()))
    return bool(fields) and fields[0][1][1] == "std_msgs/msg/Header"
