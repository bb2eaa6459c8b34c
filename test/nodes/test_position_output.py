# SPDX-License-Identifier: Apache-2.0
"""Positions and poses over DDS: each kind of message, an interrupted rollout, a dead driver."""

from __future__ import annotations

import signal
from typing import Any

import numpy as np
import pytest
from conftest import Probe, Processes, lift
from stand_ins import NAMES, Hardware

from wam_power_ros.learning.policy import Policy
from wam_power_ros.ros import interface, joint_messages


class PositionArm(Hardware):
    """Stand-in and controller of an arm that takes positions, with what each says."""

    def __init__(self, probe: Probe, processes: Processes, pace: str, output: str) -> None:
        message = joint_messages.COMMAND_TYPES["multiarray" if output == "position" else output]
        self.sent = probe.listen(message, interface.EFFORT_COMMANDS, interface.DEEP_IN)
        servo = {"command_delay_ticks": 20, "servo_lag": 0.02, "listeners": "[probe]"}
        super().__init__(probe, processes, pace, **servo, output=output)
        self.control(output=output)

    def references(self, first: int = 0) -> list[joint_messages.TorqueReading]:
        """Positions that were sent, from one on: to read them all takes long in real time."""
        return [joint_messages.torque(message, NAMES, "wam_base") for message in self.sent[first:]]

    def move(self, policy: Policy) -> None:
        """Begin a rollout, and wait until the arm moves in it."""
        self.insist("move_to_start", policy)
        self.probe.ask("execute", policy)
        start = self.state().q
        self.probe.until(lambda: np.abs(self.state().q - start).max() > 0.02, "the rollout moves")


def test_a_rollout_by_poses_ends_as_by_torques(probe: Probe, processes: Processes) -> None:
    arm = PositionArm(probe, processes, "lockstep", "pose")
    policy = lift("lifted")
    arm.insist("move_to_start", policy)
    assert probe.answer(probe.ask("execute", policy)).success
    sent = np.array([each.tau for each in arm.references()])
    assert np.ptp(sent, axis=0).max() > 0.05
    assert np.abs(np.diff(sent, axis=0)).max() < 0.02


@pytest.mark.alone
@pytest.mark.requirement("S-151")
@pytest.mark.parametrize("ended", ["controller", "driver"])
def test_an_interrupted_controller_and_a_dead_driver_leave_references_at_rest(
    probe: Probe,
    processes: Processes,
    ended: str,
    record_property: Any,  # noqa: ANN401
) -> None:
    arm = PositionArm(probe, processes, "real_time", "position")
    arm.move(lift("cut-short"))
    count, begun = len(arm.sent), arm.references(-1)[0].tau
    state = len(arm.messages)
    process = arm.controller if ended == "controller" else arm.process
    process.send_signal(signal.SIGINT if ended == "controller" else signal.SIGKILL)
    probe.spin(1.5)
    sent = np.array([each.tau for each in arm.references(count - 1)])
    steps = np.abs(np.diff(sent, axis=0)).max(axis=1)
    assert steps.max() < 0.02
    moved = np.flatnonzero(steps > 1e-6)
    figures = {"way [rad]": float(np.abs(sent[-1] - begun).max())}
    figures["messages until rest"] = int(moved[-1]) + 1 if len(moved) else 0
    assert figures["way [rad]"] < 0.3
    assert figures["messages until rest"] < 400
    if ended == "controller":
        q = np.array([message.position for message in arm.messages[state:]])
        assert np.abs(q[-1] - sent[-1]).max() < 0.01
        still = np.abs(q - q[-1]).max(axis=1) < 0.002
        figures["states until the arm rests"] = int(np.flatnonzero(~still)[-1]) + 1
        figures["way of the arm [rad]"] = float(np.abs(q[-1] - q[0]).max())
    else:
        assert arm.references(-1)[0].label == "fault"
    for name, value in figures.items():
        record_property(name, value)
