# SPDX-License-Identifier: Apache-2.0
"""Layout of the bags of this package: folders, topics, message types, QoS."""

from __future__ import annotations

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
from rosbags.typesys import Stores, get_typestore

from wam_power_ros import plain_json

TYPES = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"
STATES = "/joint_states"
EVENT = "/recorder/event"  # start and stop of the recording; only written to the bag
STOP_REQUESTED = "asked to"  # reason of a recording stopped on request
UNFINISHED = ".unfinished"
INFINITE = QosTime(9223372036, 854775807)  # an infinite duration, as written by rosbag2


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


def event(cdr: bytes) -> dict[str, Any]:
    """Contents of a message on EVENT, see `BagWriter.event`; empty if it is not one."""
    try:
        found = plain_json.parse(TYPES.deserialize_cdr(cdr, STRING).data, EVENT)
    except Exception:  # of any type, depending on the bytes
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
