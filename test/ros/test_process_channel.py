# SPDX-License-Identifier: Apache-2.0
"""Messages with arrays between two processes."""

from __future__ import annotations

import os

import numpy as np
import pytest

from wam_power_ros.ros import process_channel
from wam_power_ros.ros.process_channel import MESSAGE_MAX, Message


def test_values_and_arrays_of_any_size_arrive_as_they_were_sent_in_their_order() -> None:
    one, other = process_channel.pair()
    arrays = {"a": np.arange(600_000.0).reshape(-1, 2, 3), "b": np.array([np.pi]), "c": np.empty(0)}
    other.send({"what": "large"}, arrays)
    other.send({"what": "small", "text": "é"})
    values, received = one.receive()
    assert values == {"what": "large"}
    assert {name: array.shape for name, array in received.items()} == {
        name: array.shape for name, array in arrays.items()
    }
    assert all(np.array_equal(array, arrays[name]) for name, array in received.items())
    assert not any(array.flags.writeable for array in received.values())
    assert one.receive() == Message({"what": "small", "text": "é"}, {})


def test_arrays_outlive_their_sender_and_leave_no_descriptor_open() -> None:
    one, other = process_channel.pair()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        other.send({}, {"a": np.ones(1000)})
        received = one.receive().arrays["a"]
    other.close()
    assert received.sum() == 1000.0
    del received
    assert len(os.listdir("/proc/self/fd")) == before - 1  # the descriptor of `other`


def test_the_first_end_waits_neither_for_a_message_nor_for_its_reader() -> None:
    one, _other = process_channel.pair()
    assert one.receive() is None
    with pytest.raises(BlockingIOError):
        for _ in range(100_000):
            one.send({"what": "x" * 1000})


def test_an_end_that_was_closed_is_noticed_after_all_it_has_sent() -> None:
    one, other = process_channel.pair()
    one.send({"unread": 1})
    other.send({"last": 1})
    other.close()
    assert one.receive().values == {"last": 1}
    with pytest.raises(EOFError):
        one.receive()
    with pytest.raises(OSError):
        one.send({})


def test_values_that_would_be_cut_off_are_not_sent() -> None:
    one, other = process_channel.pair()
    with pytest.raises(ValueError, match="at most"):
        other.send({"text": "x" * MESSAGE_MAX})
    assert one.receive() is None
