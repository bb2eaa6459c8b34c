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
    (same stamp, same angles). States that came late are put in the order of their stamps. A bag
    taught with another driver may have other names for the same joints: if it has none of
    `joint_names`, and its metadata has as many names (our recorder notes them, base to tip), those
    are used. Angles are unwrapped and bad states left out: see `jumps`.

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
    arm: list[tuple[int, int, np.ndarray]] = []  # number, stamp [ns] and angles
    kinds: set[tuple[str, ...]] = set()
    for number, (stamp_ns, angles) in enumerate(states):
        if found := tuple(name for name in names if name in angles):
            kinds.add(found)
            arm.append((number, stamp_ns, np.array([angles[name] for name in found])))
    if not kinds:
        raise ValueError(
            f"no message on this topic has the joints {list(names)}; it has {sorted(seen)}. "
            "Name the joints of the arm, base to tip: wam-power bags import BAG --joints ..."
        )
    if missing := [name for name in names if name not in seen]:
        raise ValueError(f"joints {missing} missing among {sorted(seen)}")
    if len(kinds) > 1:
        sets = " and ".join(str(list(found)) for found in sorted(kinds))
        raise ValueError(f"joints are in messages of several kinds: {sets}")
    stamped = [] if by_reception else [state for state in arm if state[1]]
    timed = stamped or [(number, messages[number][0], row) for number, _, row in arm]
    of = _in_order(timed, names, simulated, part)
    if left := len(arm) - len(timed):
        text = f"{left} of {len(arm)} states left out: they have no stamp"
        return replace(of, remarks=(Remark(Grade.FAIR, text), *of.remarks))
    return of


def _in_order(
    states: Sequence[tuple[int, int, np.ndarray]],
    names: tuple[str, ...],
    simulated: bool,
    part: tuple[float, float] | None,
) -> States:
    """States that can be a movement, of number, stamp [ns] and angles of each message."""
    rows: dict[int, tuple[int, np.ndarray]] = {}  # number and angles by stamp
    newest = -(2**63)
    repeated = late = 0
    for number, stamp_ns, row in states:
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
