# SPDX-License-Identifier: Apache-2.0
"""New bags from existing ones: trim, merge and import; the existing bags are not changed."""

from __future__ import annotations

import heapq
import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np
from rosbags.interfaces import QosDurability

from wam_power_ros.bags import layout, reader
from wam_power_ros.bags.layout import EVENT, JOINT_STATE, STATES, TYPES
from wam_power_ros.bags.reader import States, Topic
from wam_power_ros.bags.writer import BagWriter, header_stamp

Message = tuple[str, int, bytes]  # topic, time of reception [ns], data


def trim(path: Path, to: Path, begin: float, end: float) -> Path:
    """Copy the part of a bag between two times [s] since its first joint state.

    All latched messages are kept.

    Raises:
        ValueError: `path` is not a bag, or has no joint state in that part.
        FileExistsError: `to` exists already.
    """
    topics = reader.topics(path)
    notes = reader.notes(path)
    states = notes.get("state_topic", STATES)
    times = [(stamp, header_stamp(data)) for _, stamp, data in reader.messages(path, [states])]
    kept = [
        stamp for stamp, time in times if begin <= (time - times[0][1]) * 1e-9 <= end
    ]  # by header stamps; a simulation may be recorded faster or slower than real time
    if not kept:
        raise ValueError(f"{path}: no message on {states} from {begin} to {end} s")
    low, high = min(kept), max(kept)
    latched = {name for name, topic in topics.items() if _latched(topic)}

    def part() -> Iterable[Message]:
        for name, stamp, data in reader.messages(path, topics):
            if low <= stamp <= high:
                yield name, stamp, data
            elif name in latched:
                yield name, min(max(stamp, low), high), data

    return _write(to, topics, sorted(part(), key=itemgetter(1)), notes)


def merge(paths: Sequence[Path], to: Path) -> Path:
    """Copy the messages of several bags into one, in the order of reception.

    Raises:
        ValueError: A path is not a bag, or a topic has two types or overlaps in time in two bags.
        FileExistsError: `to` exists already.
    """
    topics: dict[str, Topic] = {}
    spans: dict[str, list[tuple[int, int, Path]]] = {}
    for path in paths:
        for name, topic in reader.topics(path).items():
            if topics.setdefault(name, topic).msgtype != topic.msgtype:
                raise ValueError(f"{name} has types {topics[name].msgtype} and {topic.msgtype}")
            stamps = [stamp for _, stamp, _ in reader.messages(path, [name])]
            if stamps and not _latched(topic):
                spans.setdefault(name, []).append((min(stamps), max(stamps), path))
    for name, found in spans.items():
        for (_, last, one), (first, _, other) in zip(
            sorted(found), sorted(found)[1:], strict=False
        ):
            if first <= last:
                raise ValueError(f"{name} is in {one} and {other} at the same time")
    messages = heapq.merge(*(reader.messages(path, topics) for path in paths), key=itemgetter(1))
    return _write(to, topics, messages, reader.notes(paths[0]))


def import_bag(
    path: Path,
    to: Path,
    joint_names: Sequence[str],
    bag_names: Sequence[str] = (),
    topic: str = "",
    kind: str = "",
) -> Path:
    """Create a demonstration from the joint states in any rosbag2 bag, MCAP or SQLite.

    Args:
        path: Folder of the bag.
        to: Folder of the new bag.
        joint_names: Names of the arm's joints, base to tip.
        bag_names: Names of the same joints in the bag, in that order; `joint_names` if omitted.
        topic: Topic of the joint states; the only one of this type if omitted.
        kind: Stem of the demonstrated task.

    Raises:
        ValueError: As `reader.read_states`, `path` has no such topic, or the numbers of names
            differ.
        FileExistsError: `to` exists already.
    """
    bag_names = list(bag_names) or list(joint_names)
    if len(bag_names) != len(joint_names):
        raise ValueError(f"{len(bag_names)} names {bag_names} for the joints {list(joint_names)}")
    topic = topic or _only_states(path)
    states = reader.read_states(path, bag_names, topic)
    rows = {number: row for row, number in enumerate(states.index)}
    messages = [
        (STATES, stamp, _converted(data, states, rows[number], joint_names))
        for number, (_, stamp, data) in enumerate(reader.messages(path, [topic]))
        if number in rows
    ]
    notes = {
        "joint_names": json.dumps(list(joint_names)),
        "state_topic": STATES,
        "source": "imported",
        "imported": json.dumps(
            {
                "from": path.resolve().name,
                "topic": topic,
                "joints": states.names,
                "remarks": [remark.text for remark in states.remarks],
            }
        ),
    }
    offered = (layout.qos(reliable=True, latched=False),)
    return _write(to, {STATES: Topic(JOINT_STATE, offered)}, messages, notes, kind)


def _only_states(path: Path) -> str:
    """Name of the only topic of joint states."""
    topics = reader.topics(path)
    found = [name for name, topic in topics.items() if topic.msgtype == JOINT_STATE]
    if len(found) != 1:
        names = ", ".join(found or topics) or "nothing"
        what = "several topics" if found else "no topic"
        raise ValueError(f"{path} has {what} of joint states: {names}; name one with --topic")
    return found[0]


def _converted(data: bytes, states: States, row: int, joint_names: Sequence[str]) -> bytes:
    """A joint state with the names and order of the arm, and the stamp and angles as read."""
    message = layout.decoded(data, JOINT_STATE)
    order = [message.name.index(name) for name in states.names]
    for field in ("velocity", "effort"):
        values = getattr(message, field)
        complete = len(values) == len(message.name)
        setattr(message, field, values[order] if complete else np.zeros(0))
    message.name, message.position = list(joint_names), states.q[row]
    time = message.header.stamp
    time.sec, time.nanosec = divmod(int(states.stamps[row]), 1_000_000_000)
    return bytes(TYPES.serialize_cdr(message, JOINT_STATE))


def _latched(topic: Topic) -> bool:
    return bool(topic.offered) and all(
        qos.durability == QosDurability.TRANSIENT_LOCAL for qos in topic.offered
    )


def _write(
    to: Path,
    topics: Mapping[str, Topic],
    messages: Iterable[Message],
    notes: Mapping[str, str],
    kind: str = "",
) -> Path:
    """Write a bag, removed again on an error; a `kind` is noted by a start event."""
    writer = BagWriter(to)
    try:
        for name, topic in topics.items():
            writer.add(name, topic.msgtype, topic.offered)
        for name, stamp, data in messages:
            if kind and EVENT not in writer.counts:
                writer.event("start", kind, stamp)
            writer.write(name, stamp, data)
        states = notes.get("state_topic", STATES)
        return writer.close({**notes, **writer.completeness(states)})
    except BaseException:
        writer.abandon()
        shutil.rmtree(layout.unfinished(to), ignore_errors=True)
        raise
