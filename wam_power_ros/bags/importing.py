# SPDX-License-Identifier: Apache-2.0
"""Demonstrations from the joint states in bags of any recorder; these bags are not changed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wam_power_ros.bags import layout, reader
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import JOINT_STATE, STAMP_END, STATES, TYPES
from wam_power_ros.bags.quality import Remark
from wam_power_ros.bags.reader import States
from wam_power_ros.bags.writer import new_bag


def import_bag(
    bag: Bag,
    to: Path,
    joint_names: Sequence[str],
    bag_names: Sequence[str] = (),
    topic: str = "",
    kind: str = "",
    by_reception: bool = False,
    part: tuple[float, float] | None = None,
) -> tuple[Path, tuple[Remark, ...]]:
    """Create a demonstration from the joint states in a bag, read as `reader.read_states` does.

    Args:
        joint_names: Names of the arm's joints, base to tip.
        bag_names: Names of the same joints in the bag, in that order; `joint_names` if omitted.
        topic: Topic of the joint states; that of our recorder, or the only one, if omitted.
        kind: Stem of the demonstrated task.

    Returns:
        Path of the new bag, and what was left out or unwrapped in reading the states.

    Raises:
        ValueError: As `reader.read_states`, or the names are not those of the same joints.
        FileExistsError: `to` exists already.
    """
    bag_names = list(bag_names) or list(joint_names)
    if len(bag_names) != len(joint_names):
        raise ValueError(f"{len(bag_names)} names {bag_names} for the joints {list(joint_names)}")
    for theirs, name in zip(bag_names, joint_names, strict=True):
        if theirs != name and theirs in joint_names:
            raise ValueError(
                f"{theirs!r} is in the place of {name!r}: the names of the bag's joints go base to "
                f"tip, as {list(joint_names)}; their order in the messages does not matter"
            )
    topic = topic or bag.notes.get("state_topic") or _only_states(bag)
    states = reader.read_states(bag, bag_names, topic, by_reception=by_reception, part=part)
    received = states.stamps.tolist()  # in the new bag, so that they are in the order of the stamps
    if wrong := [stamp for stamp in received if not 0 <= stamp < STAMP_END]:
        raise ValueError(f"{bag.path}: {topic}: {wrong[0]} ns is no time of ROS; see --part")
    messages = list(bag.messages([topic]))
    told = {"from": bag.path.resolve().name, "topic": topic, "joints": states.names, "part": part}
    told["remarks"] = [remark.text for remark in states.remarks]
    notes = {"joint_names": json.dumps(list(joint_names)), "state_topic": STATES}
    notes |= {"arm": bag.notes["arm"]} if bag.arm else {}
    notes |= {"source": "imported", "imported": json.dumps(told)}
    with new_bag(to) as writer:
        writer.add(STATES, JOINT_STATE, [layout.qos(reliable=True, latched=False)])
        if kind:
            writer.event("start", kind, received[0])
        for row, (stamp, number) in enumerate(zip(received, states.index, strict=True)):
            data = _converted(messages[number][2], states, row, joint_names)
            writer.write(STATES, stamp, data)
        made = writer.close(notes)
    return made, states.remarks


def _only_states(bag: Bag) -> str:
    """Name of the only topic of joint states that has any."""
    found = [name for name, of in bag.topics.items() if of.msgtype == JOINT_STATE and of.found]
    if len(found) != 1:
        names = ", ".join(found or [f"{n} of {of.msgtype}" for n, of in bag.topics.items()])
        what, how = ("several", "; name one with --topic") if found else ("no", "")
        raise ValueError(f"{bag.path} has {what} topics of joint states: {names or 'nothing'}{how}")
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
