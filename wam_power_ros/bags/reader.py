# SPDX-License-Identifier: Apache-2.0
"""Reads joint states from bags of any recorder, joints by name."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from wam_power_ros.arm_identity import ArmIdentity, refusal
from wam_power_ros.bags import jumps
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import JOINT_STATE, STATES, decoded, noted_names
from wam_power_ros.bags.quality import Grade, Remark

LATE_MAX = 50_000_000  # a state may come this much after a newer one; more is a wrong clock [ns]
JOIN_MAX = 50_000_000  # longest interval over which joints are interpolated to be joined [ns]


@dataclass(frozen=True)
class States:
    """Joint states of a bag that can be a movement of an arm."""

    stamps: np.ndarray  # stamps [ns], strictly increasing (M,)
    q: np.ndarray  # joint angles [rad], finite and without a jump (M, n)
    index: np.ndarray  # which message on the topic each is, from 0 (M,)
    names: tuple[str, ...]
    remarks: tuple[Remark, ...]  # what was left out or unwrapped


def read_demonstration(
    path: Path | str, joint_names: Sequence[str], arm: ArmIdentity | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (M,) [ns] and joint angles (M, n) [rad] of a bag, as `read_states` reads them."""
    states = read_states(Bag(path), joint_names, arm=arm)
    return states.stamps, states.q


def read_states(
    bag: Bag,
    joint_names: Sequence[str],
    topic: str | None = None,
    arm: ArmIdentity | None = None,
    by_reception: bool = False,
    part: tuple[float, float] | None = None,
) -> States:
    """Joint states of a bag of any recorder: everyone reads them here.

    Joints are matched by name; time is that of the headers, or of the reception if none has one; if
    only some have none, as before the first message of a simulated clock, these are left out.
    Messages without any of these joints are another device's and are skipped, as are repetitions
    (same stamp, same angles). States that came late are put in the order of their stamps. Joints
    in messages of their own, as of two publishers, are joined: those of the fewer messages are
    interpolated at the stamps of the others. A bag taught with another driver may have other names
    for the same joints: if it has none of `joint_names`, and its metadata has as many names (our
    recorder notes them, base to tip), those are used. Angles are unwrapped and bad states left out:
    see `jumps`.

    Args:
        joint_names: Order of the columns of the result.
        topic: Topic of JointState; if omitted, the one in the metadata, else /joint_states.
        arm: Required arm, if the bag identifies its arm; any if omitted.
        by_reception: True to use the times of reception instead of the stamps of the headers.
        part: First and last time of a part, since the first state [s]; all states if omitted.

    Raises:
        ValueError: The bag is of another arm, the topic or joints are missing, a joint jumps,
            values are not finite, or stamps do not increase.
    """
    if why := refusal(bag.arm, arm):
        raise ValueError(f"{bag.path} {why}")
    topic = topic or bag.notes.get("state_topic", STATES)
    bag.type_of(topic, JOINT_STATE)
    messages = [(received_ns, cdr) for _, received_ns, cdr in bag.messages([topic])]
    try:
        states = _states(messages, tuple(joint_names), bag.notes, by_reception, part)
    except ValueError as error:
        raise ValueError(f"{bag.path}: {topic}: {error}") from None
    remarks = list(states.remarks)
    if (lost := bag.topics[topic].counted - len(messages)) > 0:
        text = f"{lost} of {bag.topics[topic].counted} messages that the bag counts are not in it"
        remarks.insert(0, Remark(Grade.FAIR, text))
    if foreign := [f"{name} ({of.msgtype})" for name, of in bag.topics.items() if of.foreign]:
        remarks.append(Remark(Grade.GOOD, f"not read: {', '.join(foreign)}"))
    return replace(states, remarks=tuple(remarks))


def _states(
    messages: Sequence[tuple[int, bytes]],
    names: tuple[str, ...],
    notes: Mapping[str, str],
    by_reception: bool,
    part: tuple[float, float] | None,
) -> States:
    noted, simulated = noted_names(notes), notes.get("source") == "sim"
    known = {*names, *noted}
    states = [_joint_angles(cdr, known) for _, cdr in messages]
    seen = {name for _, angles in states for name in angles}
    if not seen & set(names) and len(noted) == len(names):
        names = noted
    groups: dict[tuple[str, ...], list[tuple[int, int, np.ndarray]]] = {}  # by joints
    for number, (stamp_ns, angles) in enumerate(states):
        if found := tuple(name for name in names if name in angles):
            row = np.array([angles[name] for name in found])
            groups.setdefault(found, []).append((number, stamp_ns, row))
    if not groups:
        raise ValueError(
            f"no message on this topic has the joints {list(names)}; it has {sorted(seen)}. "
            "Name the joints of the arm, base to tip: wam-power bags import BAG --joints ..."
        )
    if missing := [name for name in names if name not in seen]:
        raise ValueError(f"joints {missing} missing among {sorted(seen)}")
    if sum(map(len, groups)) > len(names):
        sets = " and ".join(str(list(found)) for found in groups)
        raise ValueError(f"joints are in messages of several kinds: {sets}")
    received = [received_ns for received_ns, _ in messages]
    parts = {}
    for found, group in groups.items():
        stamped = [] if by_reception else [state for state in group if state[1]]
        timed = stamped or [(number, received[number], row) for number, _, row in group]
        of = _of_same_joints(timed, found, simulated, part)
        if left := len(group) - len(timed):
            text = f"{left} of {len(group)} states left out: they have no stamp"
            of = replace(of, remarks=(Remark(Grade.FAIR, text), *of.remarks))
        parts[found] = of
    return _joined(parts, names) if len(parts) > 1 else parts[names]


def _of_same_joints(
    group: Sequence[tuple[int, int, np.ndarray]],
    names: tuple[str, ...],
    simulated: bool,
    part: tuple[float, float] | None,
) -> States:
    """States of messages that have the same joints: number, stamp [ns] and angles of each."""
    rows: dict[int, tuple[int, np.ndarray]] = {}  # number and angles by stamp
    newest = -(2**63)
    repeated = late = 0
    for number, stamp_ns, row in group:
        if stamp_ns in rows and row.tobytes() == rows[stamp_ns][1].tobytes():
            repeated += 1
            continue
        if stamp_ns == newest and simulated:
            # The scene was reset within one tick of its clock. States before the reset, which
            # a recorder lagging behind on a busy machine wrote, belong to another movement.
            rows = {}
        elif stamp_ns in rows or stamp_ns < newest - LATE_MAX:
            raise ValueError(
                f"stamp {stamp_ns} follows {newest}; stamps must increase. Two publishers: record "
                "one. A wrong clock: wam-power bags import BAG --by-reception"
            )
        late += stamp_ns < newest
        newest = max(newest, stamp_ns)
        rows[stamp_ns] = number, row
    stamps = np.array(sorted(rows), dtype=np.int64)
    if part is not None:
        t = (stamps - stamps[0]) * 1e-9
        stamps = stamps[(t >= part[0]) & (t <= part[1])]
        if not len(stamps):
            raise ValueError(f"no state from {part[0]} to {part[1]} s; the last is at {t[-1]:.3f}")
    found = jumps.checked(stamps, np.array([rows[stamp][1] for stamp in stamps.tolist()]), names)
    index = np.array([rows[stamp][0] for stamp in stamps.tolist()])[found.kept]
    remarks = list(found.remarks)
    if late:
        remarks.insert(0, Remark(Grade.GOOD, f"{late} late states put in the order of stamps"))
    if repeated:
        counted = "1 repetition" if repeated == 1 else f"{repeated} repetitions"
        remarks.insert(0, Remark(Grade.GOOD, f"{counted} left out"))
    return States(stamps[found.kept], found.q, index, names, tuple(remarks))


def _joined(parts: Mapping[tuple[str, ...], States], names: tuple[str, ...]) -> States:
    """States of all joints, at the stamps of the part that has most, where no part has a gap."""
    first = max(parts.values(), key=lambda part: len(part.stamps))
    near = np.ones(len(first.stamps), dtype=bool)
    q = np.empty((len(first.stamps), len(names)))
    for found, part in parts.items():
        after = np.searchsorted(part.stamps, first.stamps)
        before = np.searchsorted(part.stamps, first.stamps, side="right") - 1
        inside = (before >= 0) & (after < len(part.stamps))
        last = len(part.stamps) - 1
        apart = part.stamps[after.clip(0, last)] - part.stamps[before.clip(0, last)]
        near &= inside & (apart <= JOIN_MAX)
        since = part.stamps[0]
        for name, values in zip(found, part.q.T, strict=True):
            q[:, names.index(name)] = np.interp(first.stamps - since, part.stamps - since, values)
    if not near.any():
        raise ValueError(f"joints {[*map(list, parts)]} are never there at the same time")
    of = " and ".join(", ".join(found) for found in parts)
    text = f"{near.sum()} of {len(near)} states joined from messages of their own: {of}"
    remarks = [
        Remark(Grade.GOOD, text),
        *(each for part in parts.values() for each in part.remarks),
    ]
    return States(first.stamps[near], q[near], first.index[near], names, tuple(remarks))


def _joint_angles(cdr: bytes, known: Collection[str]) -> tuple[int, dict[str, float]]:
    """Stamp [ns] and angles by name of a message; it may be malformed if no joint is known."""
    message = decoded(cdr, JOINT_STATE)
    stamp = message.header.stamp
    names, position = message.name, message.position.tolist()
    angles = dict(zip(names, position, strict=False))
    malformed = len(names) != len(position) or [angles[name] for name in names] != position
    if malformed and not known.isdisjoint(names):
        twice = "" if len(set(names)) == len(names) else "; a name is there twice, with two angles"
        raise ValueError(f"{len(position)} positions for names {names}{twice}")
    return stamp.sec * 1_000_000_000 + stamp.nanosec, angles
