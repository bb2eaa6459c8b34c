# SPDX-License-Identifier: Apache-2.0
"""Movements of bags for drawing."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from bag_samples import LATCHED
from conftest import lift
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from wam_power_interfaces.msg import Policy as PolicyMessage
from wam_power_ros.bags import reader
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.learning.policy import to_json
from wam_power_ros.view import recorded
from wam_power_ros.view.recorded import Movement
from wam_power_ros.view.skeleton import Skeleton

BAGS = Path(__file__).resolve().parents[2] / "bags"
FLIP, REACH = BAGS / "demo_20261121_121737", BAGS / "reach_20261121_141024"


def test_a_demonstration_has_its_arm_its_joints_and_the_body_in_the_pan() -> None:
    movement = recorded.read(FLIP)
    stamps, q = reader.read_demonstration(FLIP, movement.joint_names)
    np.testing.assert_array_equal(movement.q, q)
    np.testing.assert_allclose(movement.t, (stamps - stamps[0]) / 1e9)
    assert movement.body == "pancake" and movement.policy is None
    tool = Skeleton(movement.urdf, movement.joint_names).tool_path(movement.q[:1])[0]
    assert np.linalg.norm(movement.body_at(0.1)[0] - tool) < 0.1
    np.testing.assert_allclose(np.linalg.norm(movement.body_states[:, 4:], axis=1), 1.0)


def test_the_policy_of_a_rollout_is_read_and_a_text_of_another_kind_is_not(tmp_path: Path) -> None:
    shipped, policy = Bag(REACH), lift("trial-0007")
    given = {
        "policy": (recorded.POLICY_TYPE, serialize_message(PolicyMessage(text=to_json(policy)))),
        "theirs": ("std_msgs/msg/String", serialize_message(String(data=to_json(policy)))),
    }
    for name, (msgtype, cdr) in given.items():
        writer = BagWriter(tmp_path / name)
        for topic, described in shipped.topics.items():
            writer.add(topic, described.msgtype, described.offered)
        writer.add("/left/policy", msgtype, LATCHED)
        for message in shipped.messages(shipped.topics):
            writer.write(*message)
        writer.write("/left/policy", message[1], cdr)
        writer.close({})
    read = recorded.read(tmp_path / "policy").policy
    assert read is not None and to_json(read) == to_json(policy)
    assert recorded.read(tmp_path / "theirs").policy is None


def test_a_task_without_a_body_has_none() -> None:
    movement = recorded.read(REACH)
    assert movement.body == "" and movement.body_at(1.0) is None


def test_a_bag_without_a_description_is_of_the_arm_whose_joints_it_has(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(recorded, "DESCRIPTION", "/not in the bag")
    assert Skeleton(recorded.read(REACH).urdf).tool == "pan"


def test_an_invalid_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="is not a bag"):
        recorded.read(tmp_path)
    shutil.copytree(REACH, tmp_path / "cut")
    mcap = next((tmp_path / "cut").glob("*.mcap"))
    mcap.write_bytes(mcap.read_bytes()[:1000])
    with pytest.raises(ValueError, match="cut"):
        recorded.read(tmp_path / "cut")


def movement() -> Movement:
    t = np.array([0.0, 1.0, 2.0])
    seen = [[0.5, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [1.5, 0.6, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]]
    q = np.array([[0.0, 4.0], [1.0, 4.0], [3.0, 4.0]])
    return Movement("", ("a", "b"), t, q, "ball", np.array(seen), None)


def test_joints_are_interpolated_and_stay_at_the_ends() -> None:
    for t, expected in ((-1.0, [0.0, 4.0]), (1.5, [2.0, 4.0]), (9.0, [3.0, 4.0])):
        np.testing.assert_allclose(movement().joints_at(t), expected)
    assert movement().duration == 2.0


def test_a_body_is_where_it_was_last_seen_and_nowhere_before() -> None:
    assert movement().body_at(0.4) is None
    position, quat = movement().body_at(1.7)
    assert position.tolist() == [0.6, 0.0, 0.0] and quat.tolist() == [0.0, 1.0, 0.0, 0.0]
