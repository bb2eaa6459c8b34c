# SPDX-License-Identifier: Apache-2.0
"""The learner without an arm: what it refuses before it calls any service."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import ROOT, Probe, Processes, diagnosis
from toss_task import ANY_ARM, demonstrated_policy

from hardware_sim.wam import JOINTS
from wam_power_ros.bags.reader import read_demonstration
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.demonstration import from_joint_samples
from wam_power_ros.learning.policy import to_json
from wam_power_ros.nodes.learner import Learner
from wam_power_ros.params.resources import share
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import node_runner
from wam_power_ros.ros.diagnostics import LEARNER_STATE
from wam_power_ros.tasks.flip.task import Flip
from wam_power_ros.tasks.reach.task import Reach
from wam_power_ros.tasks.task import Assessment

LEARNER = "wam_power_ros.nodes.learner"
COBOT = Arm(
    share("urdf/cobot7.urdf").read_text(),
    [f"cobot_joint{i}" for i in range(1, 8)],
    "cobot_pan",
    guarded=(),
).identity()


@pytest.mark.requirement("S-59")
def test_a_learner_goes_on_with_no_session_of_another_arm(
    tmp_path: Path, processes: Processes
) -> None:
    folder = tmp_path / "session"
    policy = replace(demonstrated_policy(), arm=COBOT)
    Session.begin(folder, preset("flip"), 0, [policy]).close()
    ended = processes.node(LEARNER, "learner.yaml", session=folder)
    assert ended.wait(120.0) == 2
    said = processes.output(ended)
    assert f"policy {policy.id} belongs to another arm: cobot7" in said
    assert "this arm is wam7" in said
    Session.open(folder).close()  # nothing was written, no lock is held


def test_a_learner_refuses_what_cannot_work_before_it_reads_a_bag_or_begins_a_session(
    tmp_path: Path, processes: Processes
) -> None:
    given = {"trials": 2, "session": tmp_path / "s", "demonstrations": "['no_bag', 'no_other']"}
    ended = processes.node(LEARNER, "learner.yaml", **given)
    assert ended.wait(120.0) == 2
    said = processes.output(ended)
    assert "a budget of 2 rollouts leaves none to practise after 2 reproductions" in said
    assert "no_bag" not in said
    assert not (tmp_path / "s").exists()


def test_nodes_that_were_started_with_different_set_ups_notice_it_before_anything_moves(
    processes: Processes, tmp_path: Path
) -> None:
    controller = "wam_power_ros.nodes.torque_controller"
    processes.node(controller, "simulation.yaml", tool_speed_max=3.5)
    given = {"session": tmp_path / "s", "demonstrations": f"[{next(ROOT.glob('bags/demo_*'))}]"}
    learner = processes.node(LEARNER, "simulation.yaml", **given)
    assert learner.wait(60.0) == 2
    said = processes.output(learner)
    assert "started with another set-up than this node: tool_speed_max 3.5, here 4.0. Give" in said
    assert read(tmp_path / "s").records == ()


def test_a_learner_that_computes_a_plan_says_so(probe: Probe, domain_id: int) -> None:
    reports = probe.diagnostics()

    def told() -> str:
        learner._report()
        said = diagnosis(reports, "learner: session")
        reports.clear()
        return said.get(LEARNER_STATE, "")

    with node_runner.participant(Learner, domain_id) as learner:
        probe.until(lambda: told() == "practises", "practises")
        with learner._lock:
            probe.until(lambda: told() == "plans", "plans")


@pytest.mark.requirement("S-31")
def test_a_session_taken_up_under_lower_limits_sends_nothing_that_breaks_them(
    processes: Processes, tmp_path: Path
) -> None:
    arm = Arm(share("urdf/wam7.urdf").read_text(), JOINTS)
    taught = Flip.demonstration_of(arm, *read_demonstration(min(ROOT.glob("bags/demo_*")), JOINTS))
    policy = replace(Flip.policy_of([taught], "demonstration-1"), arm=arm.identity())
    Session.begin(tmp_path / "s", preset("flip"), 0, [policy]).close()
    low = tmp_path / "low.yaml"
    low.write_text("torque_controller: {ros__parameters: {tool_speed_max: 0.5}}")
    processes.node("wam_power_ros.nodes.torque_controller", "simulation.yaml", low)
    learner = processes.node(LEARNER, "simulation.yaml", low, session=tmp_path / "s")
    assert learner.wait(60.0) == 2
    said = processes.output(learner)
    assert "trial-0001 (reproduces demonstration-1) was not sent: with the present limits" in said
    assert read(tmp_path / "s").records == ()


def begun_session(processes: Processes, folder: Path, **params: object) -> Session:
    """Session that a learner began, which waits for an arm and is stopped there."""
    learner = processes.node(LEARNER, "learner.yaml", session=folder, **params)
    end = time.monotonic() + 120.0
    while not Session.exists(folder) and learner.poll() is None and time.monotonic() < end:
        time.sleep(0.1)
    processes.end(learner)
    assert Session.exists(folder), processes.output(learner)
    return read(folder)


def test_a_session_begins_with_a_policy_that_was_learnt_elsewhere(
    tmp_path: Path, processes: Processes
) -> None:
    policy = demonstrated_policy()
    (tmp_path / "policy.json").write_text(to_json(policy))
    bag, folder = min((ROOT / "bags").glob("demo_*")), tmp_path / "session"
    begun = begun_session(
        processes, folder, policy=tmp_path / "policy.json", demonstrations=f"['{bag}']"
    )
    assert begun.header.candidates == ["carried-over"]
    assert begun.header.demonstrations == [str(bag)]
    (carried,) = begun.policies
    assert carried.attractors.tolist() == policy.attractors.tolist()


def test_a_session_begins_with_the_policy_predicted_for_another_goal(
    tmp_path: Path, processes: Processes
) -> None:
    bags = sorted((ROOT / "bags").glob("reach_*"))
    arm = Arm(share("urdf/wam7.urdf").read_text(), JOINTS)
    taught = [from_joint_samples(arm, *read_demonstration(bag, JOINTS)) for bag in bags]
    policy = Reach.policy_of(taught, "demonstration-1")
    context = Reach.context_of(taught, None)
    seen = {"touched": False, "end": context["demonstrated"][-1]}
    with Session.begin(tmp_path / "origin", preset("reach"), 0, [policy], context=context) as known:
        practice = known.practice(ANY_ARM)
        reproduced = Assessment(0.7, observation=seen, success=True)
        known.append(practice.learn_assessed(practice.next_trial(), reproduced))
        known.save_policy(policy)
    begun = begun_session(
        processes,
        tmp_path / "session",
        task="reach",
        policy=tmp_path / "origin" / "policy.json",
        goal='"{\\"y\\": 0.3}"',
        demonstrations=[str(bag) for bag in bags],
    )
    assert begun.task.targets == {**known.task.targets, "y": pytest.approx(0.3)}
    (carried,) = begun.policies
    moved = carried.attractors - policy.attractors
    assert not moved[:-1].any()
    assert moved[-1].tolist() == pytest.approx([0.0, 0.3 - known.task.targets["y"], 0.0])
