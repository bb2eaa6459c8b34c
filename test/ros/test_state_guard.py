# SPDX-License-Identifier: Apache-2.0
"""The guard of joint states follows one publisher by the numbers of its messages."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from wam_power_ros.ros import guards
from wam_power_ros.ros.guards import REMEMBERED, SILENCE_TIMEOUT, SKIPPED_MAX, StateGuard

NODES = [
    SimpleNamespace(node_namespace="/left", node_name="arm_driver"),
    SimpleNamespace(node_namespace="/", node_name="joint_state_publisher"),
]


class Clock:
    """The guard's steady clock, set by the test."""

    def __init__(self) -> None:
        self.now = 1.0

    def monotonic(self) -> float:
        """Time [s]."""
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(guards, "time", clock)
    return clock


def guard() -> StateGuard:
    """A guard of a topic on which two nodes publish."""
    node = SimpleNamespace(
        resolve_topic_name=lambda name: f"/left/{name}",
        get_publishers_info_by_topic=lambda name: NODES if name == "/left/joint_states" else [],
    )
    return StateGuard(node, "joint_states")


def followed(states: StateGuard, *numbers: int | None, active: bool = False) -> list[bool]:
    """Which states with these numbers are followed."""
    infos = [{"publication_sequence_number": number} for number in numbers]
    return [states.follows(info, active) for info in infos]


@pytest.mark.requirement("S-130")
def test_a_publisher_that_loses_messages_or_sends_others_is_followed(clock: Clock) -> None:
    states = guard()
    numbers = (7000, 7001, 7003, 7003 + SKIPPED_MAX)
    assert all(followed(states, *numbers))
    assert states.second_publisher() is None


@pytest.mark.requirement("S-130")
def test_the_states_of_a_second_publisher_are_not_followed_and_it_is_named(clock: Clock) -> None:
    states = guard()
    assert followed(states, 7000, 12, 7001, 13, 7002, 7002) == [True, False] * 3
    assert states.second_publisher() == (
        "more than one publisher sends states of these joints on /left/joint_states: "
        "/joint_state_publisher, /left/arm_driver"
    )
    clock.now += 0.999 * REMEMBERED
    assert states.second_publisher() is not None
    clock.now += 0.002 * REMEMBERED
    assert states.second_publisher() is None


@pytest.mark.requirement("S-130")
@pytest.mark.parametrize("other", [7001 + SKIPPED_MAX, 60_000])
def test_a_second_publisher_that_has_sent_more_is_not_followed_either(
    other: int, clock: Clock
) -> None:
    assert followed(guard(), 7000, other, 7001) == [True, False, True]


@pytest.mark.requirement("S-130")
@pytest.mark.parametrize("active", [False, True])
def test_a_driver_that_was_restarted_is_followed_once_the_old_one_is_silent(
    active: bool, clock: Clock
) -> None:
    states = guard()
    assert followed(states, 7000, active=active) == [True]
    for _ in range(2):
        clock.now += 0.99 * SILENCE_TIMEOUT
        assert followed(states, 1, active=active) == [False]
        clock.now += 0.02 * SILENCE_TIMEOUT
        assert followed(states, 2, 3, active=active) == [True, True]
    assert followed(states, 7001, active=active) == [False]


@pytest.mark.requirement("S-130")
@pytest.mark.parametrize("active", [False, True])
def test_while_torques_are_sent_no_other_publisher_takes_the_place_of_a_silent_driver(
    active: bool, clock: Clock
) -> None:
    states = guard()
    for number, own in ((7000, True), (5000, False), (7001, True)):
        clock.now += 0.001
        assert followed(states, number, active=active) == [own]
    for number in range(5001, 8000):
        clock.now += 0.002
        heard = followed(states, number, active=active)
    assert heard == [not active]
    if active:  # but the driver, also one that was restarted
        assert followed(states, 7002, active=active) == [True]
        clock.now += 1.01 * SILENCE_TIMEOUT
        assert followed(states, 8000, 1, 8001, 2, active=active) == [False, True, False, True]


@pytest.mark.requirement("S-130")
def test_publishers_whose_numbers_meet_are_told_apart(clock: Clock) -> None:
    states, driver, zeros = guard(), 50_000, 52_020
    for k in range(3_000):
        clock.now += 0.002
        driver += 1
        assert followed(states, driver, active=True) == [True]
        if k % 50 == 0:  # ten a second: the driver's numbers overtake them
            clock.now += 0.001
            zeros += 1
            assert followed(states, zeros, active=True) == [False]


def test_a_middleware_without_numbers_has_one_publisher(clock: Clock) -> None:
    states = guard()
    assert all(followed(states, None, None)) and states.second_publisher() is None
