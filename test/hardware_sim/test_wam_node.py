# SPDX-License-Identifier: Apache-2.0
"""Driver of the stand-in: states, watchdog and refused torques."""

from __future__ import annotations

import signal
import time

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from conftest import Probe, Processes, Sent, lift
from control_msgs.action import FollowJointTrajectory
from stand_ins import NAMES, Hardware, arm_model

from wam_power_ros.ros import joint_messages


@pytest.mark.requirement("S-06")
def test_a_killed_controller_lets_the_arm_come_to_rest_under_its_own_gravity(
    probe: Probe, processes: Processes
) -> None:
    hardware = Hardware(probe, processes, "real_time", realtime_priority=70)
    hardware.control()
    policy = lift("killed")
    hardware.insist("move_to_start", policy)
    probe.ask("execute", policy)
    probe.spin(0.15)
    processes.end(hardware.controller, signal.SIGKILL)
    killed_ns = time.time_ns()  # older states may still arrive
    probe.until(lambda: hardware.state().stamp_ns > killed_ns, "a state of after the kill")
    arm, killed = arm_model(), hardware.state()
    count = len(hardware.messages)
    end_ns = killed.stamp_ns + 2_500_000_000  # on the clock of the arm
    probe.until(lambda: hardware.state().stamp_ns > end_ns, "2.5 s of the arm")
    after = [hardware.state(i) for i in range(count, len(hardware.messages))]
    assert len(after) > 10  # states go on; a busy machine may miss many
    height = [arm.tool_pose(reading.q)[0][2] for reading in after]
    speeds = [arm.speeds(r.q, r.qd).tool_speed for r in after]
    assert arm.tool_pose(killed.q)[0][2] - min(height) < 0.05
    assert max(speeds[len(speeds) // 2 :]) < 0.05


@pytest.fixture(scope="module")
def hardware(shared_nodes: tuple[Probe, Processes]) -> Hardware:
    """Stand-ins and a controller that two tests share; each leaves it holding."""
    hardware = Hardware(*shared_nodes, "lockstep")
    hardware.control()
    return hardware


def test_waypoints_of_a_follow_joint_trajectory_are_passed_and_a_cancel_stops_the_arm(
    hardware: Hardware,
) -> None:
    probe = hardware.probe
    start = hardware.state().q
    there = start + 0.3 * np.eye(7)[3]

    def follow(seconds: float, names: list[str] = NAMES) -> Sent:
        t, q = np.array([0.0, 0.5, 1.0]), np.array([start, there, start])
        movement = joint_messages.JointMovement(seconds * t, q)
        goal = joint_messages.movement_message(names, movement)
        return probe.ask("follow", trajectory=goal)

    def end(sent: Sent) -> tuple[int, int]:
        probe.until(lambda: sent.result, "the end of a goal")
        return sent.result.error_code, sent.status

    hardware.messages.clear()
    done = end(follow(2.0))
    assert done == (FollowJointTrajectory.Result.SUCCESSFUL, GoalStatus.STATUS_SUCCEEDED)

    def moved() -> float:
        states = [hardware.state(i).q[3] - start[3] for i in range(len(hardware.messages))]
        return max(states, default=0.0)

    probe.until(lambda: moved() > 0.27, "the states of the movement")  # behind the answer
    assert moved() < 0.33

    invalid = FollowJointTrajectory.Result.INVALID_GOAL, GoalStatus.STATUS_ABORTED
    assert end(follow(0.1)) == invalid  # too fast
    wrong = follow(2.0, [*NAMES[:6], "finger"])
    assert end(wrong) == invalid and "wam_j7" in wrong.result.error_string

    long = follow(20.0)
    probe.until(lambda: hardware.state().q[3] - start[3] > 0.05, "the arm under way")
    assert probe.cancel(long)
    _, status = end(long)
    assert status == GoalStatus.STATUS_CANCELED
    hardware.holds()
    hardware.messages.clear()
    probe.until(lambda: len(hardware.messages) > 400, "states")
    assert max(np.abs(hardware.state(i).qd).max() for i in range(-50, 0)) < 0.02
    assert hardware.state().q[3] - start[3] < 0.29
