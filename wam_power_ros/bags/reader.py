# SPDX-License-Identifier: Apache-2.0
"""Reads bags of any recorder, joints by name; damaged or malicious bags are refused."""

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
from wam_power_ros.bags.layout import JOINT_STATE, STATES, decoded, unfinished


def read_demonstration(
    path: Path | str,
    joint_names: Sequence[str],
    topic: str | None = None,
    arm: ArmIdentity | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles from a rosbag2 bag, MCAP or SQLite, of any recorder.

    Joints are matched by name; time is that of the headers. Messages without any of these joints
    are another device's and are skipped, as are repetitions (same stamp, same angles). A bag taught
    with another driver may have other names for the same joints: if it has none of `joint_names`,
    and its metadata has as many names (our recorder notes them, base to tip), those are used.

    Args:
        path: Folder of the bag.
        joint_names: Order of the columns of the result.
        topic: Topic of JointState; if omitted, the one in the metadata, else /joint_states.
        arm: Required arm, if the bag identifies its arm; any if omitted.

    Returns:
        Stamps (M,) int64 [ns], strictly increasing, and angles (M, nj) [rad].

    Raises:
        ValueError: `path` is not a bag or of another arm, the topic or joints are missing, a value
            is not finite, or stamps do not increase.
    """
    path = Path(path)
    if why := refusal(noted_arm(path), arm):
        raise ValueError(f"{path} {why}")
    noted, noted_topic, simulated = _noted(path)
    topic = topic or noted_topic
    names = tuple(joint_names)
    known = {*names, *noted}
    states = [_joint_angles(path, topic, cdr, known) for cdr in _joint_states(path, topic)]
    seen = {name for _, angles in states for name in angles}
    if not seen & set(names) and len(noted) == len(names):
        names = noted
    stamps: list[int] = []
    rows: list[tuple[float, ...]] = []
    for stamp_ns, angles in states:
        missing = [name for name in names if name not in angles]
        if len(missing) == len(names):
            continue
        if missing:
            raise ValueError(f"{path}: joints {missing} missing among {list(angles)} on {topic}")
        row = tuple(angles[name] for name in names)
        if not np.isfinite(row).all():
            raise ValueError(f"{path}: position {row} at {stamp_ns} ns on {topic} is not finite")
        if stamps and stamp_ns <= stamps[-1]:
            if stamp_ns == stamps[-1] and row == rows[-1]:
                continue
            if stamp_ns == stamps[-1] and simulated:
                # The scene was reset within one tick of its clock. States before the reset, which
                # a recorder lagging behind on a busy machine wrote, belong to another movement.
                stamps, rows = [stamp_ns], [row]
                continue
            raise ValueError(
                f"{path}: stamp {stamp_ns} follows {stamps[-1]} on {topic}; stamps must increase"
            )
        stamps.append(stamp_ns)
        rows.append(row)
    if not stamps:
        raise ValueError(
            f"{path}: no message on {topic} has the joints {list(names)}; it has {sorted(seen)}"
        )
    return np.array(stamps, dtype=np.int64), np.array(rows)


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
        names = tuple(map(str, json.loads(noted.get("joint_names", "[]"))))
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
    path: Path, topic: str, cdr: bytes, known: Collection[str]
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
    return stamp.sec * 1_000_000_000 + stamp.nanosec, angles


def _joint_states(path: Path, topic: str) -> list[bytes]:
    """Serialized joint states of a topic, in the order of reception."""
    found = topics(path)
    if topic not in found:
        raise ValueError(f"{path}: no topic {topic}; it has {sorted(found)}")
    if found[topic].msgtype != JOINT_STATE:
        raise ValueError(f"{path}: {topic} is of type {found[topic].msgtype}, not {JOINT_STATE}")
    return [cdr for _, _, cdr in messages(path, [topic])]


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
