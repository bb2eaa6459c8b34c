# SPDX-License-Identifier: Apache-2.0
"""Reads joint states from bags of any recorder, joints by name."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wam_power_ros import plain_json
from wam_power_ros.arm_identity import ArmIdentity, refusal
from wam_power_ros.bags import jumps
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import JOINT_STATE, STATES, decoded
from wam_power_ros.bags.quality import Grade, Remark


@dataclass(frozen=True)
class States:
    """Joint states of a bag that can be a movement of an arm.

    Attributes:
        stamps: Stamps [ns], strictly increasing. Shape (M,).
        q: Joint angles [rad], finite and without a jump. Shape (M, n).
        index: Which message on the topic each is, from 0. Shape (M,).
        names: Names of the joints in the bag.
        remarks: What was left out or unwrapped.
    """

    stamps: np.ndarray
    q: np.ndarray
    index: np.ndarray
    names: tuple[str, ...]
    remarks: tuple[Remark, ...]


def read_demonstration(
    path: Path | str,
    joint_names: Sequence[str],
    topic: str | None = None,
    arm: ArmIdentity | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (M,) [ns] and joint angles (M, n) [rad] of a bag, as `read_states` reads them."""
    states = read_states(Bag(path), joint_names, topic, arm)
    return states.stamps, states.q


def read_states(
    bag: Bag,
    joint_names: Sequence[str],
    topic: str | None = None,
    arm: ArmIdentity | None = None,
) -> States:
    """Joint states of a bag of any recorder: everyone reads them here.

    Joints are matched by name; time is that of the headers, or of the reception if they have none.
    Messages without any of these joints are another device's and are skipped, as are repetitions
    (same stamp, same angles). A bag taught with another driver may have other names for the same
    joints: if it has none of `joint_names`, and its metadata has as many names (our recorder notes
    them, base to tip), those are used. Angles are unwrapped and bad states left out: see `jumps`.

    Args:
        bag: The bag.
        joint_names: Order of the columns of the result.
        topic: Topic of JointState; if omitted, the one in the metadata, else /joint_states.
        arm: Required arm, if the bag identifies its arm; any if omitted.

    Raises:
        ValueError: The bag is of another arm, the topic or joints are missing, a joint jumps,
            values are not finite, or stamps do not increase.
    """
    if why := refusal(bag.arm, arm):
        raise ValueError(f"{bag.path} {why}")
    topic = topic or bag.notes.get("state_topic", STATES)
    messages = _messages(bag, topic)
    simulated = bag.notes.get("source") == "sim"
    try:
        return _states(messages, tuple(joint_names), _noted_names(bag), simulated)
    except ValueError as error:
        raise ValueError(f"{bag.path}: {topic}: {error}") from None


def _states(
    messages: Sequence[tuple[int, bytes]],
    names: tuple[str, ...],
    noted: tuple[str, ...],
    simulated: bool,
) -> States:
    known = {*names, *noted}
    states = [_joint_angles(*message, known) for message in messages]
    seen = {name for _, angles in states for name in angles}
    if not seen & set(names) and len(noted) == len(names):
        names = noted
    index: list[int] = []
    rows: dict[int, np.ndarray] = {}  # by stamp
    repeated = 0
    for number, (stamp_ns, angles) in enumerate(states):
        missing = [name for name in names if name not in angles]
        if len(missing) == len(names):
            continue
        if missing:
            raise ValueError(f"joints {missing} missing among {list(angles)}")
        row = np.array([angles[name] for name in names])
        if rows and stamp_ns <= (last := next(reversed(rows))):
            if stamp_ns in rows and row.tobytes() == rows[stamp_ns].tobytes():
                repeated += 1
                continue
            if not (stamp_ns == last and simulated):
                raise ValueError(f"stamp {stamp_ns} follows {last}; stamps must increase")
            # The scene was reset within one tick of its clock. States before the reset, which
            # a recorder lagging behind on a busy machine wrote, belong to another movement.
            index, rows = [], {}
        index.append(number)
        rows[stamp_ns] = row
    if not rows:
        raise ValueError(
            f"no message on this topic has the joints {list(names)}; it has {sorted(seen)}. "
            "Name the joints of the arm, base to tip: wam-power bags import BAG --joints ..."
        )
    stamps = np.array(list(rows), dtype=np.int64)
    found = jumps.checked(stamps, np.array(list(rows.values())), names)
    remarks = found.remarks
    if repeated:
        counted = "1 repetition" if repeated == 1 else f"{repeated} repetitions"
        remarks = (Remark(Grade.GOOD, f"{counted} left out"), *remarks)
    kept = found.kept
    return States(stamps[kept], found.q, np.array(index)[kept], names, remarks)


def _messages(bag: Bag, topic: str) -> list[tuple[int, bytes]]:
    """Times of reception [ns] and serialized joint states of a topic, in that order."""
    if topic not in bag.topics:
        raise ValueError(f"{bag.path}: no topic {topic}; it has {sorted(bag.topics)}")
    if (msgtype := bag.topics[topic].msgtype) != JOINT_STATE:
        raise ValueError(f"{bag.path}: {topic} is of type {msgtype}, not {JOINT_STATE}")
    return [(received_ns, cdr) for _, received_ns, cdr in bag.messages([topic])]


def _noted_names(bag: Bag) -> tuple[str, ...]:
    """Joint names as our recorder notes them; empty in bags of other recorders."""
    try:
        return tuple(map(str, plain_json.parse(bag.notes.get("joint_names", "[]"), "joint_names")))
    except (ValueError, TypeError):
        return ()


def _joint_angles(
    received_ns: int, cdr: bytes, known: Collection[str]
) -> tuple[int, dict[str, float]]:
    """Stamp [ns] and angles by name of a message; it may be malformed if no joint is known."""
    message = decoded(cdr, JOINT_STATE)
    stamp = message.header.stamp
    names, position = message.name, message.position.tolist()
    malformed = len(names) != len(position) or len(set(names)) != len(names)
    if malformed and not known.isdisjoint(names):
        raise ValueError(f"{len(position)} positions for names {names}")
    angles = dict(zip(names, position, strict=not malformed))
    return stamp.sec * 1_000_000_000 + stamp.nanosec or received_ns, angles
