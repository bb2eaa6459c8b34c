# SPDX-License-Identifier: Apache-2.0
"""New bags from existing ones: trim, merge and import; the existing bags are not changed."""

from __future__ import annotations

import heapq
import json
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np

from wam_power_ros.bags import layout, reader
from wam_power_ros.bags.bag import Bag, Topic
from wam_power_ros.bags.layout import JOINT_STATE, STATES, TYPES, device, noted_names
from wam_power_ros.bags.quality import Grade, Remark
from wam_power_ros.bags.reader import States
from wam_power_ros.bags.writer import BagWriter, header_stamp

Message = tuple[str, int, bytes]  # topic, time of reception [ns], data


def trim(
    bag: Bag, to: Path, begin: float, end: float, joint_names: Sequence[str] = ()
) -> tuple[Path, tuple[Remark, ...]]:
    """Copy the part of a bag between two times [s] since the first state of its arm.

    All latched messages are kept. The arm's states are those with any of `joint_names` or of the
    names in the bag's notes; without one, all on the topic of states.

    Returns:
        Path of the new bag, and the topics that were left out.

    Raises:
        ValueError: The bag has no joint state in that part, or the part cannot be read.
        FileExistsError: `to` exists already.
    """
    topic = bag.notes.get("state_topic") or (STATES if STATES in bag.topics else _only_states(bag))
    known = {*joint_names, *noted_names(bag.notes)}
    states = [
        (number, received, header_stamp(data), device(data, JOINT_STATE))
        for number, (_, received, data) in enumerate(bag.messages([topic]))
    ]
    arm = [state for state in states if not known.isdisjoint(state[3])] or states
    # By header stamps, if there are any; a simulation may be faster or slower than real time.
    times = {number: stamp for number, _, stamp, _ in arm if stamp}
    times = times or {number: received for number, received, *_ in arm}
    first = next(iter(times.values()), 0)
    inside = {number for number, time in times.items() if begin <= (time - first) * 1e-9 <= end}
    kept = [received for number, received, *_ in arm if number in inside]
    if not kept:
        raise ValueError(f"{bag.path}: no message on {topic} from {begin} to {end} s")
    low, high = min(kept), max(kept)
    outside = {number for number, *_ in arm} - inside  # perhaps received with one inside
    latched = {name for name, found in bag.topics.items() if found.latched}

    def part() -> Iterable[Message]:
        number = -1
        for name, stamp, data in bag.messages(bag.topics):
            number += name == topic
            if low <= stamp <= high:
                if name != topic or number not in outside:
                    yield name, stamp, data
            elif name in latched:
                yield name, min(max(stamp, low), high), data

    return _copy(to, bag.topics, sorted(part(), key=itemgetter(1)), bag.notes)


def merge(bags: Sequence[Bag], to: Path) -> tuple[Path, tuple[Remark, ...]]:
    """Copy the messages of several bags into one, in the order of reception.

    Returns:
        Path of the new bag, and the topics that were left out.

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
    return _copy(to, topics, messages, bags[0].notes)


def import_bag(
    bag: Bag,
    to: Path,
    joint_names: Sequence[str],
    bag_names: Sequence[str] = (),
    topic: str = "",
    kind: str = "",
    by_reception: bool = False,
) -> tuple[Path, tuple[Remark, ...]]:
    """Create a demonstration from the joint states in a bag of any recorder.

    Args:
        bag: The bag.
        to: Folder of the new bag.
        joint_names: Names of the arm's joints, base to tip.
        bag_names: Names of the same joints in the bag, in that order; `joint_names` if omitted.
        topic: Topic of the joint states; the only one of this type if omitted.
        kind: Stem of the demonstrated task.
        by_reception: True to use the times of reception instead of the stamps of the headers.

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
    states = reader.read_states(bag, bag_names, topic, by_reception=by_reception)
    rows = {number: row for row, number in enumerate(states.index)}
    messages = [
        (STATES, stamp, _converted(data, states, rows[number], joint_names))
        for number, (_, stamp, data) in enumerate(bag.messages([topic]))
        if number in rows
    ]
    notes = {
        "joint_names": json.dumps(list(joint_names)),
        **({"arm": bag.notes["arm"]} if bag.arm else {}),
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

    def check(made: Bag) -> None:
        back = reader.read_states(made, joint_names)
        if not (np.array_equal(back.q, states.q) and np.array_equal(back.stamps, states.stamps)):
            raise ValueError("other states come back than were written")

    made = _write(to, {STATES: Topic(JOINT_STATE, offered)}, messages, notes, check, kind)
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
    whole = set(states.names) <= set(message.name)  # not joined from several messages
    order = [message.name.index(name) for name in states.names] if whole else []
    for field in ("velocity", "effort"):
        values = getattr(message, field)
        complete = whole and len(values) == len(message.name)
        setattr(message, field, values[order] if complete else np.zeros(0))
    message.name, message.position = list(joint_names), states.q[row]
    time = message.header.stamp
    time.sec, time.nanosec = divmod(int(states.stamps[row]), 1_000_000_000)
    return bytes(TYPES.serialize_cdr(message, JOINT_STATE))


def _copy(
    to: Path, topics: Mapping[str, Topic], messages: Iterable[Message], notes: Mapping[str, str]
) -> tuple[Path, tuple[Remark, ...]]:
    """Write those topics to a bag whose type is known; the remarks name the others."""
    kept = {name: topic for name, topic in topics.items() if topic.msgtype in TYPES.fielddefs}
    remarks = [
        Remark(Grade.FAIR, f"{name} left out: {topic.msgtype} is not of the common interfaces")
        for name, topic in topics.items()
        if name not in kept
    ]
    if not kept:
        raise ValueError("; ".join(remark.text for remark in remarks) or "there is no topic")

    def check(made: Bag) -> None:
        names, states = noted_names(notes), notes.get("state_topic", STATES)
        if names and made.topics.get(states, Topic("", ())).counted:
            reader.read_states(made, names)

    chosen = (message for message in messages if message[0] in kept)
    return _write(to, kept, chosen, notes, check), tuple(remarks)


def _write(
    to: Path,
    topics: Mapping[str, Topic],
    messages: Iterable[Message],
    notes: Mapping[str, str],
    check: Callable[[Bag], None],
    kind: str = "",
) -> Path:
    """Write a bag and read it back; it is removed again on an error.

    A `kind` is noted by a start event; `check` refuses a bag whose contents are of no use.
    """
    writer = BagWriter(to)
    try:
        for name, topic in topics.items():
            writer.add(name, topic.msgtype, topic.offered)
        for name, stamp, data in messages:
            if kind:
                writer.event("start", kind, stamp)
                kind = ""
            writer.write(name, stamp, data)
        made = writer.close({**notes, **writer.completeness(notes)})
    except BaseException:
        writer.abandon()
        shutil.rmtree(layout.unfinished(to), ignore_errors=True)
        raise
    try:
        bag = Bag(made)
        bag.check_counts()
        check(bag)
    except BaseException as error:
        shutil.rmtree(made)
        if isinstance(error, ValueError):
            text = str(error).removeprefix(f"{made}: ")
            raise ValueError(f"{to} could not be read again and was removed: {text}") from error
        raise
    return made
