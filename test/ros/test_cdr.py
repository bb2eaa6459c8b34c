# SPDX-License-Identifier: Apache-2.0
"""Messages that the 500 Hz loop reads and writes as bytes, compared with rclpy."""

import math
from array import array

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from wam_power_ros.ros import cdr, joint_messages
from wam_power_ros.ros.stamps import time_message

NAMES = ["base", "j2", "elbow"]
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
STAMPS = st.integers(1, (2**31 - 1) * 10**9)


def state(
    stamp_ns: int, names: list[str], q: list[float], qd: list[float], **more: object
) -> bytes:
    message = JointState(name=names, position=array("d", q), velocity=array("d", qd))
    message.effort = array("d", more.get("effort", []))
    message.header.frame_id = more.get("frame", "")
    message.header.stamp = time_message(stamp_ns)
    return serialize_message(message)


def reader() -> cdr.StateReader:
    return cdr.StateReader(joint_messages.JointStateReader(NAMES))


@st.composite
def states(draw: st.DrawFn) -> bytes:
    """Our joints in any order, alone or among others, with or without velocities and efforts."""
    names = draw(
        st.permutations(NAMES + draw(st.lists(st.sampled_from(["f1", "finger"]), max_size=1)))
    )
    numbers = st.lists(NUMBERS, min_size=len(names), max_size=len(names))
    maybe = numbers | st.just([])
    return state(
        draw(STAMPS), names, draw(numbers), draw(maybe),
        effort=draw(maybe), frame=draw(st.sampled_from(["", "arm", "wam_base"])),
    )  # fmt: skip


@settings(max_examples=40)
@given(st.lists(states(), min_size=1, max_size=3), st.data())
def test_states_read_the_same_as_through_rclpy(shapes: list[bytes], data: st.DataObject) -> None:
    read = reader()
    for message in data.draw(st.lists(st.sampled_from(shapes), max_size=8)):
        ours = read(message)
        theirs = joint_messages.JointStateReader(NAMES)(deserialize_message(message, JointState))
        assert ours.stamp_ns == theirs.stamp_ns
        assert ours.q.tolist() == theirs.q.tolist()
        assert (ours.qd is None) == (theirs.qd is None)
        assert ours.qd is None or ours.qd.tolist() == theirs.qd.tolist()


def test_a_state_of_the_same_shape_is_read_without_rclpy(monkeypatch: pytest.MonkeyPatch) -> None:
    read = reader()
    read(state(1, NAMES, [1.0, 2.0, 3.0], [0.0] * 3, frame="arm"))
    monkeypatch.delattr(cdr, "deserialize_message")
    padded = bytearray(state(2_000_000_003, NAMES, [4.0, 5.0, 6.0], [7.0] * 3, frame="arm"))
    at = padded.index(b"elbow\0") + len(b"elbow\0")
    padded[at : at + 2] = b"\xaa\xbb"  # senders do not clear padding
    reading = read(bytes(padded))
    assert reading.stamp_ns == 2_000_000_003
    assert reading.q.tolist() == [4.0, 5.0, 6.0]
    assert reading.qd.tolist() == [7.0] * 3


def test_a_refused_state_with_other_names_does_not_change_how_the_next_is_read() -> None:
    read = reader()
    good = state(1, NAMES, [1.0, 2.0, 3.0], [])
    assert read(good).q.tolist() == [1.0, 2.0, 3.0]
    for stamp_ns, names, q, named in (  # of the known layout, and of another
        (1, NAMES, math.nan, "finite"),
        (0, NAMES, 1.0, "stamp"),
        (1, NAMES[::-1], math.nan, "finite"),
    ):
        with pytest.raises(ValueError, match=named):
            read(state(stamp_ns, names, [q] * 3, []))
    assert read(good).q.tolist() == [1.0, 2.0, 3.0]
    assert read(state(1, ["finger"], [0.0], [])) is None
    assert read(good).q.tolist() == [1.0, 2.0, 3.0]


@given(states(), st.data())
def test_bytes_cut_or_spoilt_are_refused_or_finite(message: bytes, data: st.DataObject) -> None:
    read = reader()
    read(message)
    spoilt = bytearray(message)
    for _ in range(data.draw(st.integers(0, 4))):
        spoilt[data.draw(st.integers(0, len(spoilt) - 1))] = data.draw(st.integers(0, 255))
    try:
        reading = read(bytes(spoilt[: data.draw(st.integers(0, len(spoilt)))]))
    except ValueError:
        return
    assert reading is None or np.isfinite(reading.q).all()


@pytest.mark.parametrize("kind", ["multiarray", "joint_state", "trajectory", "pose"])
@settings(max_examples=25)
@given(
    torques=st.lists(
        st.tuples(
            STAMPS,
            st.sampled_from(["hold", "fault", "rollout trial-0007"]),
            st.lists(NUMBERS, min_size=3, max_size=3),
        ),
        max_size=8,
    )
)
@example(torques=[(8, "hold", [0.0] * 3), (9, "hold", [1.0] * 3), (10, "hold", [2.0] * 3)])
def test_torques_are_written_as_rclpy_writes_them(
    kind: str, torques: list[tuple[int, str, list[float]]]
) -> None:
    writer = joint_messages.TorqueWriter(NAMES, kind, 0.008, "base")
    send = cdr.TorqueSerializer(writer)
    for stamp_ns, label, tau in torques:
        if kind == "pose":
            tau = [*tau, 0.0, -0.6, 0.0, 0.8]
        message = deserialize_message(send(stamp_ns, label, np.array(tau)), writer.message_type)
        reading = joint_messages.torque(message, NAMES, "base")
        assert (reading.stamp_ns, reading.label) == (stamp_ns, label)
        assert reading.tau.tolist() == tau
