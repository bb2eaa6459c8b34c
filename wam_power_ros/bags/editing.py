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

from wam_power_ros.bags import layout, reader
from wam_power_ros.bags.bag import Bag, Topic
from wam_power_ros.bags.layout import JOINT_STATE, STATES, TYPES
from wam_power_ros.bags.quality import Remark
from wam_power_ros.bags.reader import States
from wam_power_ros.bags.writer import BagWriter, header_stamp

Message = tuple[str, int, bytes]  # topic, time of reception [ns], data


def trim(bag: Bag, to: Path, begin: float, end: float) -> Path:
    """Copy the part of a bag between two times [s] since its first joint state.

    All latched messages are kept.

    Raises:
        ValueError: The bag has no joint state in that part.
        FileExistsError: `to` exists already.
    """
    states = bag.notes.get("state_topic", STATES)
    times = [(stamp, header_stamp(data)) for _, stamp, data in bag.messages([states])]
    kept = [
        stamp for stamp, time in times if begin <= (time - times[0][1]) * 1e-9 <= end
    ]  # by header stamps; a simulation may be recorded faster or slower than real time
    if not kept:
        raise ValueError(f"{bag.path}: no message on {states} from {begin} to {end} s")
    low, high = min(kept), max(kept)
    latched = {name for name, topic in bag.topics.items() if topic.latched}

    def part() -> Iterable[Message]:
        for name, stamp, data in bag.messages(bag.topics):
            if low <= stamp <= high:
                yield name, stamp, data
            elif name in latched:
                yield name, min(max(stamp, low), high), data

    return _write(to, bag.topics, sorted(part(), key=itemgetter(1)), bag.notes)


def merge(bags: Sequence[Bag], to: Path) -> Path:
    """Copy the messages of several bags into one, in the order of reception.

    Raises:
        ValueError: A topic has two types or overlaps in time in two bags.
        FileExistsError: `to` exists already.
    """
    topics: dict[str, Topic] = {}
    spans: dict[str, list[tuple[int, int, Path]]] = {}
    for bag in bags:
        for name, topic in bag.topics.items():
            if topics.setdefault(name, topic).msgtype != topic.msgtype:
                raise ValueError(f"{name} has types {topics[name].msgtype} and {topic.msgtype}")
            stamps = [stamp for _, stamp, _ in bag.messages([name])]
            if stamps and not topic.latched:
                spans.setdefault(name, []).append((min(stamps), max(stamps), bag.path))
    for name, found in spans.items():
        for (_, last, one), (first, _, other) in zip(
            sorted(found), sorted(found)[1:], strict=False
        ):
            if first <= last:
                raise ValueError(f"{name} is in {one} and {other} at the same time")
    messages = heapq.merge(*(bag.messages(topics) for bag in bags), key=itemgetter(1))
    return _write(to, topics, messages, bags[0].notes)


def import_bag(
    bag: Bag,
    to: Path,
    joint_names: Sequence[str],
    bag_names: Sequence[str] = (),
    topic: str = "",
    kind: str = "",
) -> tuple[Path, tuple[Remark, ...]]:
    """Create a demonstration from the joint states in a bag of any recorder.

    Args:
        bag: The bag.
        to: Folder of the new bag.
        joint_names: Names of the arm's joints, base to tip.
        bag_names: Names of the same joints in the bag, in that order; `joint_names` if omitted.
        topic: Topic of the joint states; the only one of this type if omitted.
        kind: Stem of the demonstrated task.

    Returns:
        Path of the new bag, and what was left out or unwrapped in reading the states.

    Raises:
        ValueError: As `reader.read_states`, or the numbers of names differ.
        FileExistsError: `to` exists already.
    """
    bag_names = list(bag_names) or list(joint_names)
    if len(bag_names) != len(joint_names):
        raise ValueError(f"{len(bag_names)} names {bag_names} for the joints {list(joint_names)}")
    topic = topic or _only_states(bag)
    states = reader.read_states(bag, bag_names, topic)
    rows = {number: row for row, number in enumerate(states.index)}
    messages = [
        (STATES, stamp, _converted(data, states, rows[number], joint_names))
        for number, (_, stamp, data) in enumerate(bag.messages([topic]))
        if number in rows
    ]
    notes = {
        "joint_names": json.dumps(list(joint_names)),
        "state_topic": STATES,
        "source": "imported",
        "imported": json.dumps(
            {
                "from": bag.path.resolve().name,
                "topic": topic,
                "joints": states.names,
                "remarks": [remark.text for remark in states.remarks],
            }
        ),
    }
    offered = (layout.qos(reliable=True, latched=False),)
    made = _write(to, {STATES: Topic(JOINT_STATE, offered)}, messages, notes, kind)
    return made, states.remarks


def _only_states(bag: Bag) -> str:
    """Name of the only topic of joint states."""
    found = [name for name, topic in bag.topics.items() if topic.msgtype == JOINT_STATE]
    if len(found) != 1:
        names = ", ".join(found or bag.topics) or "nothing"
        what = "several topics" if found else "no topic"
        raise ValueError(f"{bag.path} has {what} of joint states: {names}; name one with --topic")
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
            if kind:
                writer.event("start", kind, stamp)
                kind = ""
            writer.write(name, stamp, data)
        states = notes.get("state_topic", STATES)
        return writer.close({**notes, **writer.completeness(states)})
    except BaseException:
        writer.abandon()
        shutil.rmtree(layout.unfinished(to), ignore_errors=True)
        raise
