# SPDX-License-Identifier: Apache-2.0
"""Reads bags of any recorder, joints by name; damaged or malicious bags are refused."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rosbags.interfaces import Qos
from rosbags.rosbag2 import Reader

from wam_power_ros import plain_json, plain_yaml
from wam_power_ros.arm_identity import ArmIdentity, from_json, refusal
from wam_power_ros.bags import integrity, jumps
from wam_power_ros.bags.layout import JOINT_STATE, STATES, decoded, unfinished
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
    """Stamps (M,) [ns] and joint angles (M, n) [rad] of a bag: see `read_states`."""
    states = read_states(Path(path), joint_names, topic, arm)
    return states.stamps, states.q


def read_states(
    path: Path,
    joint_names: Sequence[str],
    topic: str | None = None,
    arm: ArmIdentity | None = None,
) -> States:
    """Joint states of a rosbag2 bag, MCAP or SQLite, of any recorder: everyone reads them here.

    Joints are matched by name; time is that of the headers, or of the reception if they have none.
    Messages without any of these joints are another device's and are skipped, as are repetitions
    (same stamp, same angles). A bag taught with another driver may have other names for the same
    joints: if it has none of `joint_names`, and its metadata has as many names (our recorder notes
    them, base to tip), those are used. Angles are unwrapped and bad states left out: see `jumps`.

    Args:
        path: Folder of the bag.
        joint_names: Order of the columns of the result.
        topic: Topic of JointState; if omitted, the one in the metadata, else /joint_states.
        arm: Required arm, if the bag identifies its arm; any if omitted.

    Raises:
        ValueError: `path` is not a bag or of another arm, the topic or joints are missing, a joint
            jumps, values are not finite, or stamps do not increase.
    """
    if why := refusal(noted_arm(path), arm):
        raise ValueError(f"{path} {why}")
    noted, noted_topic, simulated = _noted(path)
    topic = topic or noted_topic
    names = tuple(joint_names)
    known = {*names, *noted}
    states = [_joint_angles(path, topic, *each, known) for each in _joint_states(path, topic)]
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
            raise ValueError(f"{path}: joints {missing} missing among {list(angles)} on {topic}")
        row = np.array([angles[name] for name in names])
        if rows and stamp_ns <= (last := next(reversed(rows))):
            if stamp_ns in rows and row.tobytes() == rows[stamp_ns].tobytes():
                repeated += 1
                continue
            if not (stamp_ns == last and simulated):
                raise ValueError(
                    f"{path}: stamp {stamp_ns} follows {last} on {topic}; stamps must increase"
                )
            # The scene was reset within one tick of its clock. States before the reset, which
            # a recorder lagging behind on a busy machine wrote, belong to another movement.
            index, rows = [], {}
        index.append(number)
        rows[stamp_ns] = row
    if not rows:
        raise ValueError(
            f"{path}: no message on {topic} has the joints {list(names)}; it has {sorted(seen)}. "
            "Name the joints of the arm, base to tip: wam-power bags import BAG --joints ..."
        )
    stamps = np.array(list(rows), dtype=np.int64)
    try:
        found = jumps.checked(stamps, np.array(list(rows.values())), names)
    except ValueError as error:
        raise ValueError(f"{path}: {topic}: {error}") from None
    remarks = found.remarks
    if repeated:
        counted = "1 repetition" if repeated == 1 else f"{repeated} repetitions"
        remarks = (Remark(Grade.GOOD, f"{counted} left out"), *remarks)
    kept = found.kept
    return States(stamps[kept], found.q, np.array(index)[kept], names, remarks)


def noted_arm(path: Path) -> ArmIdentity | None:
    """Arm noted in a bag; None if there is no note, as in bags of other recorders.

    Raises:
        ValueError: `path` is not a bag, or the note is malformed.
    """
    noted = notes(path).get("arm", "")
    try:
        return from_json(noted)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _noted(path: Path) -> tuple[tuple[str, ...], str, bool]:
    """Joint names, topic of the states, and whether they are simulated, as our recorder notes."""
    noted = notes(path)
    try:
        names = tuple(map(str, plain_json.parse(noted.get("joint_names", "[]"), "joint_names")))
    except (ValueError, TypeError):
        return (), STATES, False  # notes of another recorder
    return names, noted.get("state_topic", STATES), noted.get("source") == "sim"


def notes(path: Path) -> dict[str, str]:
    """Notes of the recorder in the metadata of a bag.

    Raises:
        ValueError: `path` is not a bag.
    """
    return custom_data(_metadata(path))


def custom_data(metadata: object) -> dict[str, str]:
    """Notes of the recorder in the contents of a metadata.yaml; empty if there are none."""
    if isinstance(metadata, dict):
        metadata = metadata.get("rosbag2_bagfile_information", metadata)
    return texts(metadata.get("custom_data") if isinstance(metadata, dict) else None)


def texts(notes: object) -> dict[str, str]:
    """Notes with keys and values as texts; empty if they are not a mapping."""
    return {str(k): str(v) for k, v in notes.items()} if isinstance(notes, dict) else {}


def _joint_angles(
    path: Path, topic: str, received_ns: int, cdr: bytes, known: Collection[str]
) -> tuple[int, dict[str, float]]:
    """Stamp [ns] and angles by name of a message; it may be malformed if no joint is known."""
    try:
        message = decoded(cdr, JOINT_STATE)
    except ValueError as error:
        raise ValueError(f"{path}: a message on {topic}: {error}") from error
    stamp = message.header.stamp
    names, position = message.name, message.position.tolist()
    malformed = len(names) != len(position) or len(set(names)) != len(names)
    if malformed and not known.isdisjoint(names):
        raise ValueError(f"{path}: {len(position)} positions for names {names} on {topic}")
    angles = dict(zip(names, position, strict=not malformed))
    return stamp.sec * 1_000_000_000 + stamp.nanosec or received_ns, angles


def _joint_states(path: Path, topic: str) -> list[tuple[int, bytes]]:
    """Times of reception [ns] and serialized joint states of a topic, in that order."""
    found = topics(path)
    if topic not in found:
        raise ValueError(f"{path}: no topic {topic}; it has {sorted(found)}")
    if found[topic].msgtype != JOINT_STATE:
        raise ValueError(f"{path}: {topic} is of type {found[topic].msgtype}, not {JOINT_STATE}")
    return [(received_ns, cdr) for _, received_ns, cdr in messages(path, [topic])]


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        msgtype: Message type, such as "std_msgs/msg/String".
        offered: QoS of its publishers.
    """

    msgtype: str
    offered: tuple[Qos, ...]


def topics(path: Path) -> dict[str, Topic]:
    """Topics of a rosbag2 bag, in the order of their names.

    Raises:
        ValueError: `path` is not a bag, or a topic has several types.
    """
    found: dict[str, Topic] = {}
    with _reading(path) as (reader, _):
        for item in sorted(reader.connections, key=lambda item: item.topic):
            known = found.get(item.topic, Topic(item.msgtype, ()))
            if known.msgtype != item.msgtype:
                raise ValueError(f"{item.topic} has types {known.msgtype} and {item.msgtype}")
            offered = (*known.offered, *item.ext.offered_qos_profiles)
            found[item.topic] = Topic(item.msgtype, offered)
    return found


def messages(path: Path, names: Iterable[str]) -> Iterator[tuple[str, int, bytes]]:
    """Topic, time of reception [ns] and bytes of each message on some topics.

    Raises:
        ValueError: `path` is not a bag, or is damaged.
    """
    names = set(names)
    with _reading(path) as (reader, budget):
        packed = reader.compression_mode == "message"  # unpacked here, with a limit
        # Reader.messages() silently omits topics whose QoS differs between metadata.yaml and the
        # file, as in some bags of rosbag2.
        for file in reader.storage.storages:
            kept = [item for item in file.connections if item.topic in names]
            for connection, stamp_ns, cdr in file.messages(kept) if kept else ():
                if packed:
                    where = f"{path}: a message on {connection.topic}"
                    cdr = integrity.unpack(cdr, "zstd", integrity.UNPACKED_MAX, where)
                budget.spend(len(cdr))
                yield connection.topic, stamp_ns, cdr


@contextmanager
def _reading(path: Path) -> Iterator[tuple[Reader, integrity.Budget]]:
    _metadata(path)  # refused here before rosbags parses it
    try:
        with integrity.checked(path) as (folder, budget), Reader(folder) as reader:
            yield reader, budget
    except Exception as error:  # of any type, depending on the damage
        raise ValueError(f"{path} cannot be read as a bag: {error}") from error


def _metadata(path: Path) -> object:
    """Contents of metadata.yaml; ValueError if `path` is not a bag."""
    if unfinished(path).exists() and not path.exists():
        raise ValueError(f"{path} was never closed; recover it first: wam-power recover {path}")
    if not path.exists():
        raise ValueError(f"{path} is not a bag: there is no such folder")
    file = path / "metadata.yaml"
    if not file.is_file():
        raise ValueError(
            f"{path} is not a bag: it has no metadata.yaml; if it has an .mcap file: "
            f"wam-power recover {path}"
        )
    return plain_yaml.read(file)
