# SPDX-License-Identifier: Apache-2.0
"""Messages in bags are read as ROS writes them, and written so that ROS reads them."""

from __future__ import annotations

import importlib

import pytest
from conftest import ROOT
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import get_types_from_msg
from sensor_msgs.msg import JointState

from wam_power_ros.bags import layout
from wam_power_ros.bags.layout import TYPES, decoded


@pytest.mark.parametrize("name", layout.OWN)
def test_messages_of_our_own_are_defined_in_bags_as_in_their_package(name: str) -> None:
    text = (ROOT / "wam_power_interfaces/msg" / f"{name}.msg").read_text()
    msgtype = f"wam_power_interfaces/msg/{name}"
    defined = get_types_from_msg(layout.OWN[name], msgtype)
    assert defined == get_types_from_msg(text, msgtype)
    theirs = getattr(importlib.import_module("wam_power_interfaces.msg"), name)
    installed = theirs.get_fields_and_field_types()
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
    assert deserialize_message(exact, JointState) == state
    for excess in range(17):
        found = decoded(exact + bytes([0xFF]) * excess, layout.JOINT_STATE)
        assert (found.name, found.position.tolist()) == (names, position)
        assert (found.velocity.tolist(), found.effort.tolist()) == (velocity, effort)
    for size in range(len(exact)):
        with pytest.raises(ValueError, match=f"{size} bytes"):
            decoded(exact[:size], layout.JOINT_STATE)
