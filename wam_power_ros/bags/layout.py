# SPDX-License-Identifier: Apache-2.0
"""Layout of the bags of this package: folders, topics, message types and their bytes, QoS."""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from wam_power_ros import plain_json, plain_yaml

# Messages of wam_power_interfaces that are recorded; bags are also read where it is not installed.
OWN = {
    "Policy": "string id\nstring text",
    "RolloutEnd": "std_msgs/Header header\nstring policy_id\nstring fault\nstring text\n"
    "string region\nstring stop",
    "GroundTruth": "std_msgs/Header header\nstring policy_id\ndiagnostic_msgs/KeyValue[] values",
}
TYPES = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in OWN.items():
    TYPES.register(get_types_from_msg(_text, f"wam_power_interfaces/msg/{_name}"))
JOINT_STATE = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"
STATES = "/joint_states"
EVENT = "/recorder/event"  # start and stop of the recording; only written to the bag
STOP_REQUESTED = "asked to"  # reason of a recording stopped on request
STAMP_END = 2**31 * 1_000_000_000  # of a header [ns]
UNFINISHED = ".unfinished"
INFINITE = QosTime(9223372036, 854775807)  # an infinite duration, as written by rosbag2
# rosbag2's names of the policies that are not the default; before Jazzy numbers
BEST_EFFORT = ("best_effort", 2)
LATCHED = ("transient_local", 1)
ENCODINGS = {b"\0\0": False, b"\0\1": True}  # first bytes of plain CDR -> little-endian


def qos(reliable: bool, latched: bool, depth: int = 10) -> Qos:
    """A publisher's QoS as stored in a bag, so that playback offers the same."""
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=max(depth, 1),  # the ROS graph does not report the depth: it is 0
        reliability=QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=INFINITE,
        lifespan=INFINITE,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=INFINITE,
        avoid_ros_namespace_conventions=False,
    )


def described_qos(offered: Iterable[Qos]) -> list[dict[str, Any]]:
    """QoS as rosbag2 of Jazzy writes it."""

    def text(value: Any) -> Any:  # noqa: ANN401 - a policy, a time or a number
        if isinstance(value, QosTime):
            return value._asdict()
        return value.name.lower() if isinstance(value, enum.Enum) else value

    return [{key: text(value) for key, value in each._asdict().items()} for each in offered]


def parsed_qos(described: Any) -> list[Qos]:  # noqa: ANN401 - unchecked input
    """Reliability, durability and depth in QoS of any rosbag2; empty if it cannot be parsed."""
    try:
        if isinstance(described, str):
            described = plain_yaml.parse(described.encode(), "offered_qos_profiles")
        return [
            qos(
                item["reliability"] not in BEST_EFFORT,
                item["durability"] in LATCHED,
                int(item["depth"]),
            )
            for item in described or []
        ]
    except (ValueError, TypeError, KeyError):
        return []


def notes(metadata: object) -> dict[str, str]:
    """Notes of the recorder in the contents of a metadata.yaml; empty if there are none."""
    if isinstance(metadata, dict):
        metadata = metadata.get("rosbag2_bagfile_information", metadata)
    return texts(metadata.get("custom_data") if isinstance(metadata, dict) else None)


def noted_names(notes: Mapping[str, str]) -> tuple[str, ...]:
    """Joint names as our recorder notes them; empty in bags of other recorders."""
    try:
        return tuple(map(str, plain_json.parse(notes.get("joint_names", "[]"), "joint_names")))
    except (ValueError, TypeError):
        return ()


def texts(notes: object) -> dict[str, str]:
    """Notes with keys and values as texts; empty if they are not a mapping."""
    return {str(k): str(v) for k, v in notes.items()} if isinstance(notes, dict) else {}


def decoded(cdr: bytes, msgtype: str) -> object:
    """Message at the beginning of `cdr`; bytes after it are left out, as in ROS.

    `rclpy.serialization.serialize_message` returns a buffer of the size that rmw_fastrtps estimates
    in advance: up to 4 bytes too large for each empty sequence of 8-byte numbers, such as the
    efforts of many drivers. Programs that write bags with it keep the excess, of which
    `Typestore.deserialize_cdr` of rosbags refuses more than 3 bytes; its decoders do not.

    Raises:
        ValueError: The bytes are not a message of this type, or the type is unknown.
    """
    if msgtype not in TYPES.fielddefs:
        raise ValueError(f"{msgtype} is not a type of the common interfaces or of this package")
    definition = TYPES.get_msgdef(msgtype)
    encoding = bytes(cdr[:2])
    if len(cdr) < 4 or encoding not in ENCODINGS:
        raise ValueError(f"{len(cdr)} bytes that begin {encoding!r} are not a CDR message")
    little = ENCODINGS[encoding]
    decode = definition.deserialize_cdr_le if little else definition.deserialize_cdr_be
    try:
        return decode(cdr[4:], 0, definition.cls, TYPES)[0]
    except (SerdeError, struct.error, UnicodeDecodeError, ValueError) as error:
        raise ValueError(f"{len(cdr)} bytes are not a {msgtype}: {error}") from None


def event(cdr: bytes) -> dict[str, Any]:
    """Contents of a message on EVENT, see `BagWriter.event`; empty if it is not one."""
    try:
        found = plain_json.parse(decoded(cdr, STRING).data, EVENT)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def unfinished(path: Path) -> Path:
    """Folder that contains the bag `path` until it is closed."""
    return path.with_name(path.name + UNFINISHED)


def free_path(directory: Path, stem: str) -> Path:
    """The first unused path among stem, stem_2, stem_3...; unfinished bags count as used."""
    path, number = directory / stem, 1
    while path.exists() or unfinished(path).exists():
        number += 1
        path = directory / f"{stem}_{number}"
    return path
