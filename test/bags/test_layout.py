# SPDX-License-Identifier: Apache-2.0
"""Messages in bags are read as ROS writes them, and written so that ROS reads them."""

from __future__ import annotations

import importlib
import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from conftest import ROOT
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.base import normalize_fieldname
from rosidl_parser.definition import (
    AbstractSequence,
    AbstractString,
    AbstractType,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)
from sensor_msgs.msg import JointState

from wam_power_ros.bags import layout
from wam_power_ros.bags.layout import TYPES, decoded

PLACEHOLDER = "structure_needs_at_least_one_member"  # of types without a field, in rosbags alone
OURS = {  # what this package reads or records
    "diagnostic_msgs/msg/DiagnosticArray",
    "geometry_msgs/msg/PoseStamped",
    "nav_msgs/msg/Odometry",
    "nav_msgs/msg/Path",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/PointCloud2",
    "std_msgs/msg/Float64MultiArray",
    "std_msgs/msg/String",
    "trajectory_msgs/msg/JointTrajectory",
    "trajectory_msgs/msg/JointTrajectoryPoint",
    "visualization_msgs/msg/MarkerArray",
    *(f"wam_power_interfaces/msg/{name}" for name in layout.OWN),
}


def class_of(msgtype: str) -> type:
    package, _, short = msgtype.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), short)


def fields(message_type: type) -> Iterator[tuple[str, AbstractType]]:
    names = message_type.get_fields_and_field_types()
    return zip(names, message_type.SLOT_TYPES, strict=True)


def nested(kind: NamespacedType) -> type:
    return getattr(importlib.import_module(".".join(kind.namespaces)), kind.name)


def sequences(message_type: type) -> int:
    """Number of sequences in a type, those of nested types included."""
    count = 0
    for _, kind in fields(message_type):
        count += isinstance(kind, AbstractSequence)
        inner = kind.value_type if hasattr(kind, "value_type") else kind
        if isinstance(inner, NamespacedType):
            count += sequences(nested(inner))
    return count


def drawn(message_type: type, rng: np.random.Generator, filled: Iterator[bool]) -> object:
    """A message with random values; the next of `filled` decides whether a sequence is empty."""

    def value(kind: AbstractType) -> object:
        if isinstance(kind, NamespacedType):
            return drawn(nested(kind), rng, filled)
        if isinstance(kind, AbstractString):
            return "".join(rng.choice(list("aZ 9_/é→"), size=rng.integers(0, 9)))
        assert isinstance(kind, BasicType)
        name = kind.typename
        if name == "boolean":
            return bool(rng.integers(2))
        if name == "octet":
            return bytes([rng.integers(256)])
        if name in ("float", "double"):
            return float(np.float32(rng.normal()) if name == "float" else rng.normal())
        info = np.iinfo(np.uint8 if name in ("char", "uint8") else name)
        return int(rng.integers(info.min, info.max, endpoint=True, dtype=info.dtype))

    message = message_type()
    for name, kind in fields(message_type):
        if isinstance(kind, Array):
            found: object = [value(kind.value_type) for _ in range(kind.size)]
        elif isinstance(kind, AbstractSequence):
            most = kind.maximum_size if isinstance(kind, BoundedSequence) else 4
            size = int(rng.integers(1, most, endpoint=True)) if next(filled) else 0
            found = [value(kind.value_type) for _ in range(size)]
        else:
            found = value(kind)
        setattr(message, name, found)
    return message


def plain(found: object) -> object:
    """Values of a message of rclpy or rosbags as dicts, lists and numbers."""
    if hasattr(found, "get_fields_and_field_types"):
        names = found.get_fields_and_field_types()
        return {normalize_fieldname(name): plain(getattr(found, name)) for name in names}
    if hasattr(found, "__msgtype__"):
        names = (name for name, _ in TYPES.get_msgdef(found.__msgtype__).fields)
        return {name: plain(getattr(found, name)) for name in names if name != PLACEHOLDER}
    if isinstance(found, bytes):
        return found[0]
    if isinstance(found, str):
        return found
    if np.ndim(found) or isinstance(found, list):
        return [plain(each) for each in found]
    number = np.asarray(found).item()
    return number & 0xFF if isinstance(number, int) and -128 <= number < 0 else number


def messages(msgtype: str) -> Iterator[object]:
    """Messages of a type, with sequences empty and filled."""
    message_type, rng = class_of(msgtype), np.random.default_rng(0)
    count = sequences(message_type)
    yield drawn(message_type, rng, itertools.repeat(False))
    yield drawn(message_type, rng, itertools.repeat(True))
    for choice in itertools.product((False, True), repeat=min(count, 8)):
        yield drawn(message_type, rng, itertools.cycle(choice or (True,)))


@pytest.mark.parametrize("msgtype", sorted(OURS))
def test_what_ros_writes_is_read_and_what_is_written_is_read_by_ros(msgtype: str) -> None:
    for message in messages(msgtype):
        theirs = serialize_message(message)
        found = decoded(theirs, msgtype)
        assert plain(found) == plain(message)
        ours = bytes(TYPES.serialize_cdr(found, msgtype))
        assert deserialize_message(ours, class_of(msgtype)) == message
        # Alike but for padding, which ROS does not clear, and for what follows the message.
        differ = [ours[k] for k in range(len(ours)) if ours[k] != theirs[k]]
        assert not any(differ)


@pytest.mark.parametrize("name", layout.OWN)
def test_messages_of_our_own_are_defined_in_bags_as_in_their_package(name: str) -> None:
    text = (ROOT / "wam_power_interfaces/msg" / f"{name}.msg").read_text()
    msgtype = f"wam_power_interfaces/msg/{name}"
    defined = get_types_from_msg(layout.OWN[name], msgtype)
    assert defined == get_types_from_msg(text, msgtype)
    installed = class_of(msgtype).get_fields_and_field_types()
    assert [field for field, _ in defined[msgtype][1]] == list(installed)


@pytest.mark.parametrize("velocity", [[], [0.5, 0.25]])
@pytest.mark.parametrize("effort", [[], [1.0, 2.0]])
def test_bytes_after_a_message_are_left_out_and_missing_ones_are_refused(
    velocity: list[float], effort: list[float]
) -> None:
    names, position = ["a", "b"], [0.1, 0.2]
    state = JointState(name=names, position=position, velocity=velocity, effort=effort)
    read = decoded(serialize_message(state), layout.JOINT_STATE)
    exact = bytes(TYPES.serialize_cdr(read, layout.JOINT_STATE))
    for excess in range(17):
        found = decoded(exact + bytes([0xFF]) * excess, layout.JOINT_STATE)
        assert (found.name, found.position.tolist()) == (names, position)
        assert (found.velocity.tolist(), found.effort.tolist()) == (velocity, effort)
    for size in range(len(exact)):
        with pytest.raises(ValueError, match=f"{size} bytes"):
            decoded(exact[:size], layout.JOINT_STATE)
