# SPDX-License-Identifier: Apache-2.0
"""Reader: round trip, agreement with another reader, and errors that name the damage."""

import json
from pathlib import Path

import numpy as np
import pytest
from bag_samples import NAMES, QOS, START, demonstration, joint_state, of_states, random_q
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from wam_power_ros import arm_identity
from wam_power_ros.arm_identity import ArmIdentity
from wam_power_ros.bags import layout
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.reader import read_demonstration, read_states
from wam_power_ros.bags.writer import BagWriter


def test_a_demonstration_comes_back_bit_for_bit_in_the_order_asked_for(tmp_path: Path) -> None:
    q = random_q()
    path = demonstration(tmp_path / "demo", q)
    stamps, back = read_demonstration(path, NAMES)
    np.testing.assert_array_equal(back, q)
    np.testing.assert_array_equal(stamps, START + 2_000_000 * np.arange(len(q)))
    _, swapped = read_demonstration(path, ("wam_j3", "wam_j1"))
    np.testing.assert_array_equal(swapped, q[:, [2, 0]])


def test_a_bag_taught_under_another_driver_is_read_by_the_order_it_notes(tmp_path: Path) -> None:
    q = random_q(50)
    path = demonstration(tmp_path / "demo", q)
    _, back = read_demonstration(path, ("right_j1", "right_j2", "right_j3"))
    np.testing.assert_array_equal(back, q)
    with pytest.raises(ValueError, match="right_j1"):  # another arm: it has not as many joints
        read_demonstration(path, ("right_j1", "right_j2"))
    with pytest.raises(ValueError, match="right_j1"):  # some of ours: not another driver
        read_demonstration(path, ("right_j1", "wam_j2", "wam_j3"))


def test_an_independent_reader_decodes_the_bag(tmp_path: Path) -> None:
    q = random_q(50)
    path = demonstration(tmp_path / "demo", q)
    with (path / "demo.mcap").open("rb") as file:
        mcap = make_reader(file, decoder_factories=[DecoderFactory()])
        found = list(mcap.iter_decoded_messages(topics=["/joint_states"]))
        summary = mcap.get_summary()
    ours = [message for *_, message in found if message.name == list(NAMES)]
    np.testing.assert_array_equal([message.position for message in ours], q)
    assert ours[1].header.stamp.nanosec == 125_456_789
    schemas = {schema.name: schema for schema in summary.schemas.values()}
    assert schemas[layout.JOINT_STATE].encoding == "ros2msg"
    assert b"MSG: builtin_interfaces/Time" in schemas[layout.JOINT_STATE].data


ONES = [1.0] * 3


@pytest.mark.parametrize(
    ("states", "why"),
    [
        ([(START, NAMES, [1.0, np.nan, 0.0])], "not finite"),
        ([(START, NAMES[:2], [1.0, 2.0])], "missing among"),
        ([(START, NAMES, [1.0, 2.0])], "2 positions for names"),
        ([(START, ("wam_j1",) * 2, [1.0, 2.0])], "2 positions for"),
        ([(START, NAMES, ONES), (START - 60_000_000, NAMES, ONES)], "follows"),
        ([(START, NAMES, ONES), (START, NAMES, [2.0] * 3)], "follows"),
        ([(START, ("hand",), [1.0])], "no message on"),
        ([], "no topic /joint_states"),
    ],
)
def test_states_that_cannot_be_a_demonstration_are_refused_by_name(
    tmp_path: Path, states: list[tuple[int, tuple[str, ...], list[float]]], why: str
) -> None:
    path = of_states(tmp_path / "demo", [(START + k, *state) for k, state in enumerate(states)])
    with pytest.raises(ValueError, match=why):
        read_demonstration(path, NAMES)


def test_another_device_on_the_topic_may_leave_its_positions_out(tmp_path: Path) -> None:
    others = (NAMES, [1.0, 2.0, 3.0]), (("finger",), []), (("finger",) * 2, [0.1])
    path = of_states(tmp_path / "demo", [(START, START, *each) for each in others])
    assert len(read_demonstration(path, NAMES)[0]) == 1


@pytest.mark.parametrize("source", ["sim", "hardware"])
def test_states_of_before_a_simulated_reset_are_another_movement(
    tmp_path: Path, source: str
) -> None:
    """A reset moves the arm between two ticks; a recorder that lags has states of before it."""
    writer = BagWriter(tmp_path / "demo")
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    before, after = random_q(3, seed=1), random_q(5, seed=2)
    stamps = [START + 2_000_000 * k for k in (0, 1, 2, 2, 3, 4, 5, 6)]
    for stamp_ns, row in zip(stamps, [*before, *after], strict=True):
        writer.write("/joint_states", stamp_ns, joint_state(stamp_ns, NAMES, row))
    path = writer.close({"joint_names": json.dumps(NAMES), "source": source})
    if source == "hardware":  # there two states of one stamp are two drivers, or a broken one
        with pytest.raises(ValueError, match="follows"):
            read_demonstration(path, NAMES)
        return
    back_ns, back = read_demonstration(path, NAMES)
    np.testing.assert_array_equal(back, after)
    assert back_ns.tolist() == stamps[3:]


def test_a_wrong_topic_or_type_is_named_with_what_there_is(tmp_path: Path) -> None:
    path = demonstration(tmp_path / "demo", random_q(3))
    with pytest.raises(ValueError, match=r"no topic /joints; it has \['/joint_states'"):
        read_states(Bag(path), NAMES, "/joints")
    with pytest.raises(ValueError, match="is of type"):
        read_states(Bag(path), NAMES, "/robot_description")
    with pytest.raises(ValueError, match=r"no metadata\.yaml"):
        read_demonstration(tmp_path, NAMES)
    with pytest.raises(ValueError, match="there is no such folder"):
        read_demonstration(tmp_path / "nowhere", NAMES)
    with pytest.raises(ValueError, match="not a type of the common interfaces"):
        BagWriter(tmp_path / "x").add("/custom", "wam_msgs/msg/RTJointPosition", QOS)


@pytest.mark.requirement("S-17")
@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("!!python/object/apply:os.system ['touch {mark}']", "not plain YAML"),
        ("rosbag2_bagfile_information: !!python/name:os.system", "not plain YAML"),
        ("a: &a [x]\nb: *a", "references"),
        ("[" * 100_000, "nested deeper|nesting depth"),  # PyYAML 6.0.4 has a limit of its own
        ("x" * 1_000_001, "1000001 bytes"),
        ("a: b: c: :", "not plain YAML"),
        ("{}", "cannot be read"),
        ("- 1", "cannot be read"),
        (
            "rosbag2_bagfile_information: {version: 9, storage_identifier: mcap, "
            "relative_file_paths: [../../secret.mcap]}",
            "cannot be read",
        ),
    ],
)
def test_a_hostile_metadata_file_is_refused_and_runs_nothing(
    tmp_path: Path, text: str, why: str
) -> None:
    path = demonstration(tmp_path / "demo", random_q(3))
    mark = tmp_path / "ran"
    (path / "metadata.yaml").write_text(text.replace("{mark}", str(mark)))
    with pytest.raises(ValueError, match=why):
        read_demonstration(path, NAMES)
    assert not mark.exists()


@pytest.mark.requirement("S-17")
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_a_damaged_file_is_refused_or_read_and_nothing_else(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("bags") / "demo"
    demonstration(path, random_q(3))
    file = path / "demo.mcap"
    damaged = bytearray(file.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    file.write_bytes(damaged[: data.draw(st.integers(0, len(damaged)))])
    try:
        _, q = read_demonstration(path, NAMES)
    except ValueError as error:
        assert str(path) in str(error)
    else:
        assert np.isfinite(q).all()


@pytest.mark.requirement("S-59")
def test_a_bag_of_another_arm_is_refused_and_one_that_does_not_say_is_read(tmp_path: Path) -> None:
    ours = ArmIdentity("wam7", NAMES, "1" * 64, "2" * 64)
    theirs = ArmIdentity("cobot7", ("c1", "c2", "c3"), "a" * 64, "b" * 64)
    for name, noted in (("ours", ours), ("theirs", theirs), ("unknown", None)):
        writer = BagWriter(tmp_path / name)
        writer.add("/joint_states", layout.JOINT_STATE, QOS)
        for index, row in enumerate(random_q(5)):
            stamp_ns = START + 2_000_000 * index
            joints = NAMES if noted is None else noted.joint_names
            writer.write("/joint_states", stamp_ns, joint_state(stamp_ns, joints, row))
        notes = {} if noted is None else {"arm": arm_identity.to_json(noted)}
        writer.close(notes | {"joint_names": json.dumps(joints)})
        assert Bag(tmp_path / name).arm == noted
    for name in ("ours", "unknown"):
        _, q = read_demonstration(tmp_path / name, NAMES, arm=ours)
        np.testing.assert_array_equal(q, random_q(5))
    with pytest.raises(ValueError, match=r"theirs belongs to another arm: cobot7 .*; .* is wam7"):
        read_demonstration(tmp_path / "theirs", NAMES, arm=ours)
    read_demonstration(tmp_path / "theirs", NAMES)  # who does not ask reads it by its order
