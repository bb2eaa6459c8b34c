# SPDX-License-Identifier: Apache-2.0
"""A second commander on the topic prevents activation, and is noticed when it appears later."""

from __future__ import annotations

import time

import pytest
from conftest import Probe
from std_msgs.msg import Float64MultiArray

from wam_power_ros.ros import interface
from wam_power_ros.ros.command_guard import SILENCE_TIMEOUT, CommandGuard

COMMAND = Float64MultiArray(data=[0.0] * 7)


@pytest.fixture
def guard(probe: Probe) -> CommandGuard:
    """A guard of the command topic."""
    ours = probe.node.create_publisher(
        Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND
    )
    return CommandGuard(probe.node, ours)


def test_alone_on_the_topic_we_may_begin_and_nobody_intrudes(
    probe: Probe, guard: CommandGuard
) -> None:
    probe.spin(0.2)
    assert guard.begin() is None
    probe.spin(0.2)
    assert guard.intruder() is None


def test_whoever_commands_while_we_are_silent_keeps_us_from_starting_until_it_stops(
    probe: Probe, guard: CommandGuard
) -> None:
    other = probe.publisher(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND)

    def refusal() -> str | None:
        other.publish(COMMAND)
        probe.spin(0.02)
        reason = guard.begin()
        guard.listen()
        return reason

    reason = probe.until(refusal, "the refusal")
    assert "another publisher sends commands" in reason
    time.sleep(SILENCE_TIMEOUT)
    assert guard.begin() is None  # it is still announced, but does not send
    assert guard.intruder() is None


def test_a_publisher_that_appears_while_we_send_is_an_intruder_once(
    probe: Probe, guard: CommandGuard
) -> None:
    assert guard.begin() is None
    probe.publisher(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND, readers=0)
    text = probe.until(guard.intruder, "the second commander")
    assert "other publishers on the command topic" in text
    assert guard.intruder() is None  # reported once; the fault is latched
