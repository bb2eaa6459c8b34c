# SPDX-License-Identifier: Apache-2.0
"""Bags are read by joint name, whoever recorded them; a damaged or hostile one is refused."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rosbags.interfaces import Qos
from rosbags.rosbag2 import Reader

from wam_power_ros import plain_yaml
from wam_power_ros.arm_identity import ArmIdentity, from_json, refusal
from wam_power_ros.bags import integrity
from wam_power_ros.bags.layout import JOINT_STATE, STATES, TYPES, unfinished


def read_demonstration(
    path: Path | str,
    joint_names: Sequence[str],
    topic: str | None = None,
    arm: ArmIdentity | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles from a rosbag2 bag, MCAP or SQLite, whoever recorded it.

    Joints are matched by name and time is that of the headers. Messages without any of our joints
    are another device's and left out, as are repetitions (same stamp, same angles). A bag taught
    under another driver has other names for the same joints: if it has none of ours, and notes as
    many (our recorder does, base to tip), these are taken.

    Args:
        path: Folder of the bag.
        joint_names: Order of the columns of the result.
        topic: Topic of JointState; the one the bag notes, or /joint_states, if omitted.
        arm: Arm that the bag must be of, as far as it says; any if omitted.

    Returns:
        Stamps (M,) int64 [ns], strictly increasing, and angles (M, nj) [rad].

    Raises:
        ValueError: Naming what is wrong: no bag, of another arm, no such topic, joints missing, a
            value that is not finite, stamps that go back.
    """
    path = Path(path)
    if why := refusal(noted_arm(path), arm):
        raise ValueError(f"{path} {why}")
    noted, noted_topic, simulated = _noted(path)
    topic = topic or noted_topic
    ours = tuple(joint_names)
    known = {*ours, *noted}
    states = [_joint_angles(path, topic, cdr, known) for cdr in _messages(path, topic, JOINT_STATE)]
    seen = {name for _, angles in states for name in angles}
    if not seen & set(ours) and len(noted) == len(ours):
        ours = noted
    stamps: list[int] = []
    rows: list[tuple[float, ...]] = []
    for stamp_ns, angles in states:
        missing = [name for name in ours if name not in angles]
        if len(missing) == len(ours):
            continue
        if missing:
            raise ValueError(f"{path}: joints {missing} missing among {list(angles)} on {topic}")
        row = tuple(angles[name] for name in ours)
        if not np.isfinite(row).all():
            raise ValueError(f"{path}: position {row} at {stamp_ns} ns on {topic} is not finite")
        if stamps and stamp_ns <= stamps[-1]:
            if stamp_ns == stamps[-1] and row == rows[-1]:
                continue
            if stamp_ns == stamps[-1] and simulated:
                # The scene was reset between two ticks of its clock; a recorder that lags behind
                # on a busy machine has states of before: they belong to another movement.
                stamps, rows = [stamp_ns], [row]
                continue
            raise ValueError(f"{path}: stamp {stamp_ns} follows {stamps[-1]} on {topic}")
        stamps.append(stamp_ns)
        rows.append(row)
    if not stamps:
        raise ValueError(
            f"{path}: no message on {topic} has the joints {list(ours)}; it has {sorted(seen)}"
        )
    return np.array(stamps, dtype=np.int64), np.array(rows)


def noted_arm(path: Path) -> ArmIdentity | None:
    """Arm that a bag is of; None if it does not say, as those of other recorders.

    Raises:
        ValueError: It is no bag, or what it says is no identity.
    """
    _check_metadata(path)
    notes = custom_data(plain_yaml.read(path / "metadata.yaml"))
    try:
        return from_json(notes.get("arm", ""))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _noted(path: Path) -> tuple[tuple[str, ...], str, bool]:
    """Joint names, topic of the states, and whether they are simulated, as our recorder notes."""
    _check_metadata(path)
    try:
        custom = custom_data(plain_yaml.read(path / "metadata.yaml"))
        names = tuple(map(str, json.loads(custom.get("joint_names", "[]"))))
        return names, str(custom.get("state_topic", STATES)), custom.get("source") == "sim"
    except (ValueError, TypeError):
        return (), STATES, False  # another recorder's notes, or none


def custom_data(metadata: object) -> dict[str, str]:
    """What a recorder noted in the metadata of a bag; empty when there is nothing of the kind."""
    for key in ("rosbag2_bagfile_information", "custom_data"):
        if isinstance(metadata, dict) and key in metadata:
            metadata = metadata[key]
        elif key == "custom_data":
            return {}
    notes = metadata if isinstance(metadata, dict) else {}
    return {str(key): str(value) for key, value in notes.items()}


def _joint_angles(
    path: Path, topic: str, cdr: bytes, known: Collection[str]
) -> tuple[int, dict[str, float]]:
    """Stamp and angles of a message; of a device without a known joint those that it has."""
    try:
        message = TYPES.deserialize_cdr(cdr, JOINT_STATE)
    except Exception as error:  # whatever bytes make the decoder raise
        raise ValueError(f"{path}: a message on {topic} is not a JointState: {error}") from error
    stamp = message.header.stamp
    names, position = message.name, message.position.tolist()
    odd = len(names) != len(position) or len(set(names)) != len(names)
    if odd and not known.isdisjoint(names):
        raise ValueError(f"{path}: {len(position)} positions for names {names} on {topic}")
    return stamp.sec * 1_000_000_000 + stamp.nanosec, dict(zip(names, position, strict=not odd))


def _messages(path: Path, topic: str, msgtype: str) -> list[bytes]:
    """Serialized messages of a topic, in the order of reception."""
    found = topics(path)
    if topic not in found:
        raise ValueError(f"{path}: no topic {topic}; it has {sorted(found)}")
    if found[topic].msgtype != msgtype:
        raise ValueError(f"{path}: {topic} is of type {found[topic].msgtype}, not {msgtype}")
    return [cdr for _, _, cdr in messages(path, [topic])]


@dataclass(frozen=True)
class Topic:
    """What a bag says of one of its topics.

    Attributes:
        msgtype: As in "std_msgs/msg/String".
        offered: QoS of its publishers.
    """

    msgtype: str
    offered: tuple[Qos, ...]


def topics(path: Path) -> dict[str, Topic]:
    """Topics of a rosbag2 bag, in the order of their names.

    Raises:
        ValueError: It is no bag, or a topic has several types.
    """
    found: dict[str, Topic] = {}
    with _reading(path) as (reader, _):
        for item in sorted(reader.connections, key=lambda item: item.topic):
            known = found.get(item.topic, Topic(item.msgtype, ()))
            if known.msgtype != item.msgtype:
                raise ValueError(f"{item.topic} is of type {known.msgtype} and {item.msgtype}")
            offered = (*known.offered, *item.ext.offered_qos_profiles)
            found[item.topic] = Topic(item.msgtype, offered)
    return found


def messages(path: Path, names: Iterable[str]) -> Iterator[tuple[str, int, bytes]]:
    """Topic, time of reception [ns] and bytes of the messages of some topics, in that order.

    Raises:
        ValueError: It is no bag, or damaged.
    """
    names = set(names)
    with _reading(path) as (reader, budget):
        packed = reader.compression_mode == "message"  # unpacked here, with a limit
        # Not Reader.messages(): it leaves out, without a word, topics of which metadata.yaml has
        # another QoS than the file, as some bags of rosbag2 do.
        for file in reader.storage.storages:
            kept = [item for item in file.connections if item.topic in names]
            for connection, stamp_ns, cdr in file.messages(kept) if kept else ():
                if packed:
                    where = f"{path}: a message on {connection.topic}"
                    cdr = integrity.unpack(cdr, "zstd", integrity.UNPACKED_MAX, where)
                budget.take(len(cdr))
                yield connection.topic, stamp_ns, cdr


@contextmanager
def _reading(path: Path) -> Iterator[tuple[Reader, integrity.Budget]]:
    _check_metadata(path)
    try:
        with integrity.checked(path) as (folder, budget), Reader(folder) as reader:
            yield reader, budget
    except Exception as error:  # whatever a damaged file makes the reader raise
        raise ValueError(f"{path} cannot be read as a bag: {error}") from error


def _check_metadata(path: Path) -> None:
    """Refuse a metadata.yaml that is not one before anything builds objects of it."""
    if unfinished(path).exists() and not path.exists():
        raise ValueError(f"{path} was never closed; recover it first: wam-power recover {path}")
    if not path.exists():
        raise ValueError(f"{path} is not a bag: there is nothing of that name")
    file = path / "metadata.yaml"
    if not file.is_file():
        raise ValueError(
            f"{path} is not a bag: it has no metadata.yaml; if it has an .mcap file: "
            f"wam-power recover {path}"
        )
    plain_yaml.read(file)
