# SPDX-License-Identifier: Apache-2.0
"""The policy for a goal that was never tried, predicted from a session."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from reach_task import CONTEXT, DEMONSTRATION, practised
from toss_task import AnyArm

from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.new_goal import policy_for
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.reach.task import Reach

ARM = AnyArm()
GOALS = ({"y": 0.35}, {"y": 0.15, "z": 0.58}, {"x": 0.62, "y": 0.2})


@pytest.fixture(scope="module")
def origin() -> Practice:
    """Session that was confirmed for another goal."""
    practice = practised(DEMONSTRATION, seed=1)
    assert practice.confirmed
    return practice


def predicted(origin: Practice, goal: dict[str, float], arm: AnyArm = ARM) -> tuple[Policy, str]:
    return policy_for(origin.task, origin.candidates, origin.records, goal, arm, "carried-over")


@pytest.mark.parametrize("goal", GOALS)
def test_a_goal_that_was_never_tried_is_attained_by_the_first_rollout_and_confirmed_in_few(
    origin: Practice, goal: dict[str, float]
) -> None:
    policy, why = predicted(origin, goal)
    assert why == f"predicted from {origin.confirmed + 5} rollouts of {origin.records[-1].id}"
    practice = practised(policy, seed=2, context=origin.task.with_goal(CONTEXT, goal))
    first = practice.records[0]
    assert first.success and first.observation["goal_distance"] < 0.02
    assert practice.confirmed and practice.used <= 10
    assert all(record.success for record in practice.records)


def test_what_made_the_answer_succeed_is_kept(origin: Practice) -> None:
    policy, answer = predicted(origin, GOALS[0])[0], origin.best.policy
    np.testing.assert_array_equal(policy.stiffness, answer.stiffness)
    np.testing.assert_array_equal(policy.attractors[:-1], answer.attractors[:-1])
    moved = policy.attractors[-1] - answer.attractors[-1]
    assert np.abs(moved).argmax() == 1 and moved[1] == pytest.approx(0.1, abs=0.03)


def test_a_goal_that_the_arm_cannot_reach_is_approached(origin: Practice) -> None:
    def too_far(policy: Policy) -> str:
        return "too far" * bool(policy.attractors[-1, 1] > 0.33)

    policy, why = predicted(origin, {"y": 0.45}, AnyArm(too_far))
    assert 0.25 < policy.attractors[-1, 1] <= 0.33
    assert why.endswith("0.25 of the way") or why.endswith("0.5 of the way")


def test_rollouts_that_tell_of_no_goal_predict_none(origin: Practice) -> None:
    explored = [record for record in origin.records if record.kind == "explore"]
    with pytest.raises(ValueError, match="no rollout without exploration tells"):
        policy_for(origin.task, origin.candidates, explored, GOALS[0], ARM, "carried-over")
    task = origin.task
    for told in ({"touched": True, "end": [0.0] * 3}, {"touched": False}, None):  # older: no end
        assert task.attained(SimpleNamespace(fault="", observation=told)) is None
    met = {"touched": False, "end": [0.1, 0.2, 0.3]}
    assert task.attained(SimpleNamespace(fault="", observation=met))["y"] == 0.2
    assert task.attained(SimpleNamespace(fault="tool speed", observation=met)) is None


def test_a_demonstration_is_moved_to_another_goal_and_begins_where_it_began(
    origin: Practice,
) -> None:
    context = origin.task.with_goal(CONTEXT, {"z": 0.7})
    moved = Reach(origin.task.settings, context)
    assert moved.goal_values == {**origin.task.goal_values, "z": pytest.approx(0.7)}
    np.testing.assert_array_equal(moved.demonstrated[0], origin.task.demonstrated[0])
    assert moved.region == origin.task.region
    with pytest.raises(ValueError, match="a goal of reach is x, y, z, not 'radius'"):
        origin.task.with_goal(CONTEXT, {"radius": 0.1})
    flip = preset("flip").make_task({})
    assert not flip.goal_values
    with pytest.raises(ValueError, match="task flip has no goal that can be changed"):
        flip.with_goal({}, {"y": 0.3})
