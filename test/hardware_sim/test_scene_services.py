# SPDX-License-Identifier: Apache-2.0
"""Reset and demonstration over DDS."""

from __future__ import annotations

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from conftest import Probe, Processes, lift
from stand_ins import TICK, Hardware, arm_model

from hardware_sim.scenes import HOME
from hardware_sim.settings import REACH_GOAL
from wam_power_ros.learning.policy import Policy
from wam_power_ros.ros import interface
from wam_power_ros.ros.outcomes import Code


@pytest.fixture(scope="module")
def hardware(shared_nodes: tuple[Probe, Processes]) -> Hardware:
    """Stand-ins and a controller that several tests share; each leaves it holding."""
    hardware = Hardware(*shared_nodes, "lockstep")
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


def test_a_scene_is_reset_or_demonstrated_in_one_goal_at_a_time(hardware: Hardware) -> None:
    probe = hardware.probe
    policy = lift("put-back")
    hardware.insist("move_to_start", policy)
    first, second = probe.ask("reset", policy), probe.ask("reset", policy)
    assert {probe.answer(first).code, probe.answer(second).code} == {Code.DONE, Code.BUSY}
    hardware.free()
    first, second = probe.ask("demonstrate"), probe.ask("demonstrate")
    assert {probe.answer(first).code, probe.answer(second).code} == {Code.DONE, Code.BUSY}
    assert not probe.cancel(first)  # it has ended
    hardware.give_back()
    hardware.holds()


def test_the_demonstrator_guides_the_arm_under_gravity_compensation_only(
    hardware: Hardware,
) -> None:
    assert hardware.ask("demonstrate").code is Code.BUSY
    hardware.free()
    starts = []
    for _ in range(2):
        hardware.messages.clear()
        assert hardware.ask("demonstrate").code is Code.DONE
        speed = max(np.abs(hardware.state(i).qd).max() for i in range(len(hardware.messages)))
        assert speed > 2.0  # a toss
        starts.append(speed)
    assert starts[0] != starts[1]  # different tosses
    hardware.give_back()
    hardware.holds()


@pytest.mark.long
def test_in_real_time_states_go_on_while_the_pancake_is_put_back(
    probe: Probe, processes: Processes
) -> None:
    hardware = Hardware(probe, processes, "real_time", realtime_priority=70)
    hardware.control()
    policy = lift("put-back")
    # A reset takes at least 50 states; all of them would be missing if it blocked the process, and
    # the controller would latch a fault. A busy machine may do so in one reset, but not in all.
    outcomes: list[tuple[str, bool]] = []  # of each reset: mode after it, short gaps in between
    while ("hold", True) not in outcomes and len(outcomes) < 5:
        hardware.insist("move_to_start", policy)
        hardware.messages.clear()
        hardware.insist("reset", policy)
        # on a busy machine they arrive after the answer
        probe.until(lambda: len(hardware.messages) > 50, "the states meanwhile")
        stamps = [hardware.state(i).stamp_ns for i in range(len(hardware.messages))]
        apart = np.diff(stamps)
        assert (apart > 0).all() and (apart % TICK == 0).all()
        hardware.diagnostics.clear()
        outcomes.append((probe.until(hardware.label, "its mode"), bool(apart.max() < 25 * TICK)))
    assert ("hold", True) in outcomes, outcomes


@pytest.mark.long
def test_a_scene_without_a_body_can_be_reset_taught_and_practised(
    probe: Probe, processes: Processes
) -> None:
    arm, policy = arm_model(), lift("reach-0001")
    start = arm.tool_pose(policy.q_start)[0].tolist()  # region at the start of rollouts
    hardware = Hardware(
        probe, processes, "lockstep", body="", scene="reach", guarded_region=[*start, 0.02]
    )
    topics = {name for name, _ in probe.node.get_topic_names_and_types()}
    assert not [name for name in topics if "pancake" in name or name == f"/{interface.MARKERS}"]
    hardware.control()
    hardware.free()
    for _ in range(2):
        assert hardware.ask("reset").code is Code.DONE
        probe.until(lambda: np.abs(hardware.state().q - HOME).max() < 0.05, "the arm at home")
        assert hardware.ask("demonstrate").code is Code.DONE
        probe.until(
            lambda: np.linalg.norm(arm.tool_pose(hardware.state().q)[0] - REACH_GOAL) < 0.08,
            "the tool at the goal",
        )
    hardware.give_back()
    _, truth = hardware.rollout(policy, (0.0, 0.0))
    assert hardware.truths[0].policy_id == policy.id
    assert truth["touched"]
    assert -0.0201 < truth["clearance"] < -0.015
    assert truth["goal_distance"] > 0.1
