# SPDX-License-Identifier: Apache-2.0
"""JSON of files and messages: plain data is returned, anything else is refused by its origin."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, lift
from diagnostic_msgs.msg import KeyValue
from hypothesis import given, settings
from hypothesis import strategies as st

from wam_power_interfaces.msg import GroundTruth
from wam_power_ros import arm_identity, plain_json
from wam_power_ros.bags import layout, quality, reader, series
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.control import replay_trajectory
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning import demonstration
from wam_power_ros.learning.policy import from_json
from wam_power_ros.practice import session
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import pose_messages

DEEP = "[" * 100_000 + "]" * 100_000
DATA = st.recursive(
    st.text(max_size=10)
    | st.integers(-(2**128), 2**128)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.booleans()
    | st.none(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=12,
)


@settings(max_examples=40)
@given(DATA)
def test_plain_data_comes_back(data: object) -> None:
    assert plain_json.parse(json.dumps(data), "x") == data
    assert plain_json.parse(json.dumps(data, ensure_ascii=False).encode(), "x") == data


@pytest.mark.requirement("S-102")
@pytest.mark.parametrize(
    ("text", "says"),
    [
        (DEEP, "is nested deeper than 20 levels"),
        ("[" * 990 + "]" * 990, "is nested deeper than 20 levels"),  # Python itself reads it
        ("[1e400]", "1e400 is not a finite number"),
        ("9" * 5000, "is beyond 128 bits"),
        ('{"a": 1, "a": 2}', "key 'a' appears twice"),
        ("", "is not JSON"),
        (b"\xff", "is not JSON"),
        ("1 " + " " * 1_000_000, "has 1000002 bytes"),
    ],
)
def test_json_that_is_not_plain_is_refused_with_its_origin(text: str | bytes, says: str) -> None:
    with pytest.raises(ValueError, match=f"the record.*{says}"):
        plain_json.parse(text, "the record")


def test_brackets_in_texts_do_not_count_and_the_limit_itself_is_allowed() -> None:
    assert plain_json.parse(json.dumps(["[{" * 50 + '"\\']), "x") == ["[{" * 50 + '"\\']
    deepest = "[" * 20 + "]" * 20
    assert json.dumps(plain_json.parse(deepest, "x")) == deepest


def begun(folder: Path) -> Path:
    session.Session.begin(folder, preset("flip"), 0, [lift("demonstration-1")]).close()
    return folder


@pytest.mark.requirement("S-102")
@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("rollouts.jsonl", DEEP + "\n", r"rollouts\.jsonl, line 1: the line is nested deeper"),
        ("task.json", DEEP, r"task\.json is nested deeper than 20 levels"),
        ("task.json", " " * 1_000_001, r"task\.json has 1000001 bytes"),
        ("acknowledged.json", DEEP, r"acknowledged\.json is nested deeper than 20 levels"),
        ("candidates/demonstration-1.json", DEEP, "policy text is nested deeper"),
    ],
)
def test_a_hostile_file_of_a_session_is_refused_by_name_and_line(
    name: str, text: str, says: str, tmp_path: Path
) -> None:
    folder = begun(tmp_path / "s")
    (folder / name).write_text(text)
    with pytest.raises(ValueError, match=says):
        session.Session.open(folder)


@pytest.mark.requirement("S-102")
def test_a_hostile_text_of_a_bag_a_series_or_a_message_is_refused_by_name(tmp_path: Path) -> None:
    for name, arm in (("hostile", DEEP), ("bag", "")):
        shipped = Bag(min((ROOT / "bags").glob("demo_*")))
        writer = BagWriter(tmp_path / name)
        for topic, described in shipped.topics.items():
            writer.add(topic, described.msgtype, [])
        for message in shipped.messages(shipped.topics):
            writer.write(*message)
        writer.close({"arm": arm, "joint_names": DEEP})
    with pytest.raises(ValueError, match="hostile: identity of an arm is nested deeper"):
        _ = Bag(tmp_path / "hostile").arm
    names = [f"wam_j{i}" for i in range(1, 8)]
    reader.read_demonstration(tmp_path / "bag", names)  # as of another recorder
    (tmp_path / series.FILE).write_text(DEEP)
    with pytest.raises(ValueError, match=r"demonstrations\.json is nested deeper"):
        series.read(tmp_path / series.FILE)
    with pytest.raises(ValueError, match="a value of the ground truth is nested deeper"):
        pose_messages.ground_truth(GroundTruth(values=[KeyValue(key="caught", value=DEEP)]))
    with pytest.raises(ValueError, match="policy text is nested deeper"):
        from_json(DEEP)
    with pytest.raises(ValueError, match="identity of an arm is nested deeper"):
        arm_identity.from_json(DEEP)
    text = layout.TYPES.types[layout.STRING](data=DEEP)
    assert layout.event(layout.TYPES.serialize_cdr(text, layout.STRING).tobytes()) == {}


@pytest.mark.requirement("S-102")
@pytest.mark.parametrize(("joints", "value"), [([2], 31.0), (list(range(7)), -1e300)])
def test_a_position_that_no_joint_has_is_refused_by_its_stamp(
    joints: list[int], value: float
) -> None:
    arm = Arm((ROOT / "urdf/wam7.urdf").read_text(), [f"wam_j{i}" for i in range(1, 8)])
    stamps = np.arange(1000) * 2_000_000
    q = np.zeros((1000, 7))
    q[500, joints] = value
    says = rf"q\[500, {joints[0]}\] = .* rad at stamp 1000000000; at most 30 rad"
    with pytest.raises(ValueError, match=says):
        demonstration.from_joint_samples(arm, stamps, q)
    with pytest.raises(ValueError, match=says):
        replay_trajectory.movement(stamps, q, 1.0)
    with pytest.raises(ValueError, match=says):
        quality.movement_remarks(*demonstration.smooth_joints(stamps, q), [], None)
