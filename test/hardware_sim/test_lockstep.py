# SPDX-License-Identifier: Apache-2.0
"""The stand-ins in lockstep, with one controller: rollouts, movements, resets, demonstrations."""

from __future__ import annotations

import os

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from conftest import Probe, Processes, lift
from geometry_msgs.msg import PoseStamped
from stand_ins import Hardware

from wam_power_ros.learning.policy import Policy
from wam_power_ros.ros import interface, pose_messages
from wam_power_ros.ros.outcomes import Code


@pytest.fixture(scope="module")
def hardware(shared_nodes: tuple[Probe, Processes]) -> Hardware:
    """Stand-ins and a controller that several tests share; each leaves it holding."""
    hardware = Hardware(*shared_nodes, "lockstep", realtime_priority=70)
    hardware.control()
    return hardware


def test_a_reset_is_refused_without_a_free_arm_and_away_from_the_start_of_its_policy(
    hardware: Hardware,
) -> None:
    probe = hardware.probe
    assert hardware.ask("reset").code is Code.BUSY
    policy = lift("far-away")
    far = Policy(**{**vars(policy), "q_start": policy.q_start + 0.3})
    away = hardware.ask("reset", far)
    assert away.code is Code.NOT_AT_START and "from the start of far-away" in away.text
    few = hardware.ask("reset", Policy(**{**vars(policy), "q_start": policy.q_start[:6]}))
    assert few.code is Code.REFUSED and "for 6 joints, not 7" in few.text
    sent = probe.ask("reset", "{")
    assert probe.answer(sent).code is Code.REFUSED and sent.status == GoalStatus.STATUS_ABORTED


def test_a_scene_is_reset_or_demonstrated_in_one_goal_at_a_time_the_latter_if_the_arm_is_free(
    hardware: Hardware,
) -> None:
    probe = hardware.probe
    policy = lift("put-back")
    hardware.call_until_success("move_to_start", policy)
    first, second = probe.ask("reset", policy), probe.ask("reset", policy)
    assert {probe.answer(first).code, probe.answer(second).code} == {Code.DONE, Code.BUSY}
    assert hardware.ask("demonstrate").code is Code.BUSY
    hardware.free()
    hardware.messages.clear()
    first, second = probe.ask("demonstrate"), probe.ask("demonstrate")
    assert {probe.answer(first).code, probe.answer(second).code} == {Code.DONE, Code.BUSY}
    assert not probe.cancel(first)  # it has ended
    speeds = [fastest(hardware)]
    hardware.messages.clear()
    assert hardware.ask("demonstrate").code is Code.DONE
    speeds.append(fastest(hardware))
    assert min(speeds) > 2.0 and speeds[0] != speeds[1]  # different tosses
    hardware.give_back()


def test_the_cameras_do_not_see_the_body_while_it_is_put_back(hardware: Hardware) -> None:
    """So that a tracker begins anew, and refuses no frame for a turn that no body can make."""
    probe, policy = hardware.probe, lift("covered")
    topic = interface.body_topic("pancake", "pose")
    poses = probe.listen(PoseStamped, topic, interface.STATE_RECORD)
    hardware.call_until_success("move_to_start", policy)
    probe.until(lambda: len(poses) > 3, "frames before the reset")
    hardware.call_until_success("reset", policy)
    there = len(poses)
    probe.until(lambda: len(poses) > there + 3, "frames after the reset")
    stamps_ns = [pose_messages.pose(pose).stamp_ns for pose in poses]
    assert 3 * 33_333_333 <= np.diff(stamps_ns).max() < 10 * 33_333_333


def fastest(hardware: Hardware) -> float:
    """Highest speed of a joint [rad/s] since the messages were cleared."""
    return max(np.abs(hardware.state(i).qd).max() for i in range(len(hardware.messages)))


def test_a_rollout_in_lockstep_is_the_same_whenever_its_services_are_called(
    hardware: Hardware,
) -> None:
    probe = hardware.probe
    poses = probe.listen(
        PoseStamped, interface.body_topic("pancake", "pose"), interface.STATE_RECORD
    )
    policy = lift("trial-0001")
    results, frames = [], []
    for pauses in ((0.0, 0.0), (0.02, 0.11)):
        poses.clear()
        message, truth = hardware.rollout(policy, pauses)
        start_ns, *path = pose_messages.path(message)
        end_ns = start_ns + 1_000_000_000
        probe.until(  # frames that were lost are sent again
            lambda: any(pose_messages.pose(pose).stamp_ns >= end_ns for pose in poses),  # noqa: B023
            "the last frame",
        )
        seen = [pose_messages.pose(pose) for pose in poses]
        at = {reading.stamp_ns - start_ns: reading.position.tolist() for reading in seen}
        frames.append({stamp: place for stamp, place in at.items() if 0 <= stamp < 1_000_000_000})
        results.append((*(values.tolist() for values in path), truth))
    assert results[0] == results[1]
    assert len(frames[0]) >= 25
    assert frames[0] == frames[1]
    assert truth["id"] == policy.id
    assert truth["caught"]
    other = hardware.rollout(lift("trial-0002"), (0.0, 0.0))[0]  # other noise
    assert pose_messages.path(other).position.tolist() != results[0][1]
    for process in (hardware.process, hardware.controller):  # no real time, whatever is asked for
        assert os.sched_getscheduler(process.pid) == os.SCHED_OTHER
