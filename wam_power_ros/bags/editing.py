# SPDX-License-Identifier: Apache-2.0
"""New bags of others: a part of one, several in one, one of another recorder; none is changed."""

from __future__ import annotations

import heapq
import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np
from rosbags.interfaces import QosDurability

from wam_power_ros import plain_yaml
from wam_power_ros.bags import layout, reader
from wam_power_ros.bags.layout import JOINT_STATE, STATES, TYPES
from wam_power_ros.bags.reader import Topic
from wam_power_ros.bags.writer import BagWriter, header_stamp

Message = tuple[str, int, bytes]  # topic, time of reception [ns], data


def trim(path: Path, to: Path, begin: float, end: float) -> Path:
    """Copy the part of a bag between two times [s] since its first joint state.

    Latched messages are kept whenever they came.

    Raises:
        ValueError: It is no bag, or has no joint state in that part.
        FileExistsError: `to` exists already.
    """
    topics = reader.topics(path)
    notes = _notes(path)
    states = notes.get("state_topic", STATES)
    times = [(stamp, header_stamp(data)) for _, stamp, data in reader.messages(path, [states])]
    kept = [
        stamp for stamp, time in times if begin <= (time - times[0][1]) * 1e-9 <= end
    ]  # by the device's clock; a simulation may be recorded faster or slower than it runs
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

    return _written(to, topics, sorted(part(), key=itemgetter(1)), notes)


def merge(paths: Sequence[Path], to: Path) -> Path:
    """Copy the messages of several bags into one, in the order of their reception.

    Raises:
        ValueError: One is no bag, or a topic is in two of them at the same time or of two types.
        FileExistsError: `to` exists already.
    """
    topics: dict[str, Topic] = {}
    spans: dict[str, list[tuple[int, int, Path]]] = {}
    for path in paths:
        for name, topic in reader.topics(path).items():
            if topics.setdefault(name, topic).msgtype != topic.msgtype:
                raise ValueError(f"{name} is of type {topics[name].msgtype} and {topic.msgtype}")
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
    return _written(to, topics, messages, _notes(paths[0]))


def import_bag(
    path: Path,
    to: Path,
    joint_names: Sequence[str],
    theirs: Sequence[str] = (),
    topic: str = "",
    kind: str = "",
) -> Path:
    """Make a demonstration of the joint states in any rosbag2 bag, MCAP or SQLite.

    Args:
        path: Folder of the bag.
        to: Folder of the new bag.
        joint_names: Names of our joints, base to tip.
        theirs: Names of the same joints in the bag, in that order; ours if omitted.
        topic: Topic of the joint states; the only one of this type if omitted.
        kind: Stem of the task that it demonstrates.

    Raises:
        ValueError: It is no bag, has no such topic or joints, or not one value for each name.
        FileExistsError: `to` exists already.
    """
    theirs = list(theirs) or list(joint_names)
    if len(theirs) != len(joint_names):
        raise ValueError(f"{len(theirs)} names {theirs} for the joints {list(joint_names)}")
    topic = topic or _only_states(path)
    messages = [
        (STATES, stamp, renamed)
        for _, stamp, data in reader.messages(path, [topic])
        if (renamed := _renamed(path, data, stamp, theirs, joint_names))
    ]
    if not messages:
        seen = {name for _, _, data in reader.messages(path, [topic]) for name in _names(data)}
        raise ValueError(
            f"{path}: no message on {topic} has the joints {theirs}; it has {sorted(seen)}. Name "
            "those of the arm, base to tip, with --joints"
        )
    notes = {
        "joint_names": json.dumps(list(joint_names)),
        "state_topic": STATES,
        "source": "imported",
        "imported": json.dumps({"from": path.resolve().name, "topic": topic, "joints": theirs}),
    }
    offered = (layout.qos(reliable=True, latched=False),)
    return _written(to, {STATES: Topic(JOINT_STATE, offered)}, messages, notes, kind)


def _only_states(path: Path) -> str:
    found = [name for name, topic in reader.topics(path).items() if topic.msgtype == JOINT_STATE]
    if len(found) != 1:
        others = ", ".join(found or reader.topics(path)) or "nothing"
        what = "several topics" if found else "no topic"
        raise ValueError(f"{path} has {what} of joint states: {others}; name one with --topic")
    return found[0]


def _names(data: bytes) -> list[str]:
    return list(TYPES.deserialize_cdr(data, JOINT_STATE).name)


def _renamed(
    path: Path, data: bytes, stamp: int, theirs: Sequence[str], ours: Sequence[str]
) -> bytes | None:
    """Joint state in our names and order; None for a state of other joints.

    Raises:
        ValueError: Some of the joints are missing, or it is not a joint state.
    """
    message = TYPES.deserialize_cdr(data, JOINT_STATE)
    place = {name: index for index, name in enumerate(message.name)}
    missing = [name for name in theirs if name not in place]
    if len(missing) == len(theirs):
        return None
    if missing:
        raise ValueError(f"{path}: joints {missing} missing among {list(message.name)}")
    order = [place[name] for name in theirs]
    for field in ("position", "velocity", "effort"):
        values = getattr(message, field)
        whole = len(values) == len(message.name)
        setattr(message, field, values[order] if whole else np.zeros(0))
    message.name = list(ours)
    time = message.header.stamp
    if time.sec == time.nanosec == 0:  # a driver without stamps: when it came
        time.sec, time.nanosec = divmod(stamp, 1_000_000_000)
    return bytes(TYPES.serialize_cdr(message, JOINT_STATE))


def _notes(path: Path) -> dict[str, str]:
    return reader.custom_data(plain_yaml.read(path / "metadata.yaml"))


def _latched(topic: Topic) -> bool:
    return bool(topic.offered) and all(
        qos.durability == QosDurability.TRANSIENT_LOCAL for qos in topic.offered
    )


def _written(
    to: Path,
    topics: Mapping[str, Topic],
    messages: Iterable[Message],
    notes: Mapping[str, str],
    kind: str = "",
) -> Path:
    """Write a bag, or nothing of it when something is wrong; `kind` of an event at its start."""
    writer = BagWriter(to)
    try:
        for name, topic in topics.items():
            writer.add(name, topic.msgtype, topic.offered)
        begun = not kind
        for name, stamp, data in messages:
            if not begun:
                writer.event("start", kind, stamp)
                begun = True
            writer.write(name, stamp, data)
        states = notes.get("state_topic", STATES)
        return writer.close({**notes, **writer.completeness(states)})
    except BaseException:
        writer.abandon()
        shutil.rmtree(layout.unfinished(to), ignore_errors=True)
        raise
