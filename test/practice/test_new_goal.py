# SPDX-License-Identifier: Apache-2.0
"""The policy for a goal that was never tried, predicted from a session."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from reach_task import CONTEXT, DEMONSTRATION, practised
from toss_task import ANY_ARM, AnyArm, demonstrated_policy

from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.new_goal import context_for, policy_for
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.parametrization import TURN_OF_AMPLITUDE, TURN_OF_TEMPO, TURN_OF_WRIST
from wam_power_ros.tasks.flip.toss_errors import APEX_OF_AMPLITUDE

ARM = AnyArm()
GOALS = ({"y": 0.35}, {"y": 0.15, "z": 0.58}, {"x": 0.62, "y": 0.2})
FLIP, CUP = preset("flip"), preset("ball_in_cup")
TOSS = {"tossed": True, "seen": True, "angle": math.pi, "landing_error": [0.0, 0.0, 0.1]}
TOSS |= {"catch_pitch": 0.0, "apex": 0.6}
NAMES = ("amplitude", "tempo", "wrist_amplitude")


@pytest.fixture(scope="module")
def origin() -> Practice:
    """Session that was confirmed for another goal."""
    practice = practised(DEMONSTRATION, seed=1)
    assert practice.confirmed
    return practice


def predicted(origin: Practice, goal: dict[str, float], arm: AnyArm = ARM) -> tuple[Policy, str]:
    task = origin.settings.make_task(context_for(origin.settings, CONTEXT, goal))
    return policy_for(task, origin.task, origin.candidates, origin.records, arm, "carried-over")


@pytest.mark.parametrize("goal", GOALS)
def test_a_goal_that_was_never_tried_is_attained_by_the_first_rollout_and_confirmed_in_few(
    origin: Practice, goal: dict[str, float]
) -> None:
    policy, why = predicted(origin, goal)
    assert why == f"predicted from {origin.confirmed + 5} rollouts of {origin.records[-1].id}"
    practice = practised(policy, seed=2, context=context_for(origin.settings, CONTEXT, goal))
    first = practice.records[0]
    assert first.success and first.observation["goal_distance"] < 0.02
    assert practice.confirmed and practice.used <= 10
    assert all(record.success for record in practice.records)


def test_a_goal_that_the_arm_cannot_reach_is_approached(origin: Practice) -> None:
    def too_far(policy: Policy) -> str:
        return "too far" * bool(policy.attractors[-1, 1] > 0.33)

    policy, why = predicted(origin, {"y": 0.4}, AnyArm(too_far))
    assert 0.25 < policy.attractors[-1, 1] <= 0.33
    assert why.endswith("0.25 of the way") or why.endswith("0.5 of the way")


def test_rollouts_that_tell_of_no_goal_predict_none(origin: Practice) -> None:
    explored = [record for record in origin.records if record.kind == "explore"]
    faulted = [SimpleNamespace(**{**vars(r), "fault": "tool speed"}) for r in origin.records]
    for told in (explored, faulted):
        with pytest.raises(ValueError, match="no rollout without exploration tells"):
            policy_for(origin.task, origin.task, origin.candidates, told, ARM, "carried-over")
    task = origin.task
    for seen in ({"touched": True, "end": [0.0] * 3}, {"touched": False}, None):  # older: no end
        assert task.error(seen) is None
    met = {"touched": False, "end": [*task.targets.values()]}
    assert task.error(met).tolist() == [0.0] * 3


def test_a_demonstration_is_moved_to_another_goal_and_begins_where_it_began(
    origin: Practice,
) -> None:
    context = context_for(origin.settings, CONTEXT, {"z": 0.7})
    moved = origin.settings.make_task(context)
    assert moved.targets == {**origin.task.targets, "z": 0.7}
    np.testing.assert_allclose(moved.demonstrated[-1], [*moved.targets.values()])
    np.testing.assert_array_equal(moved.demonstrated[0], origin.task.demonstrated[0])
    assert moved.region == origin.task.region
    again = origin.settings.make_task(context_for(origin.settings, context, {"x": 0.6}))
    assert again.targets == {**origin.task.targets, "x": 0.6, "z": 0.7}


@pytest.mark.parametrize(
    ("settings", "goal", "says"),
    [
        (preset("reach"), {"radius": 0.1}, "a goal of reach is x, y, z, not 'radius'"),
        (FLIP, {"y": 0.3}, "a goal of flip is apex, not 'y'"),
        (FLIP, {"apex": 0.1}, "apex = 0.1 m must be above delta_h = 0.12 m"),
        (CUP, {"string": 0.1}, r"string = 0.1 m must be 0.2 to 0.6 m"),
    ],
)
def test_what_is_no_goal_of_a_task_is_refused(
    settings: object, goal: dict[str, float], says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        context_for(settings, CONTEXT if settings.task == "reach" else {}, goal)


def run_of(settings: object, observation: dict[str, object], goal: dict[str, float]) -> Policy:
    """Policy for a goal, predicted from one reproduction that told this."""
    known, task = (settings.make_task(c) for c in ({}, context_for(settings, {}, goal)))
    policy = demonstrated_policy()
    size = known.parametrization(policy).size
    told = {"kind": "mean", "fault": "", "id": "trial-0001", "demonstration": policy.id}
    record = SimpleNamespace(**told, z=[0.0] * size, observation=observation)
    return policy_for(task, known, [policy], [record], ANY_ARM, "new")[0]


def test_a_lower_toss_is_less_vigorous_and_turns_as_far() -> None:
    task = FLIP.make_task(context_for(FLIP, {}, {"apex": 0.5}))
    assert [error.name for error in task.learnt_errors()][-1] == "apex"
    assert "apex" not in [error.name for error in FLIP.make_task({}).wanted_errors()]
    assert task.error(TOSS)[-1] == pytest.approx(4.0)
    policy = demonstrated_policy()
    parametrization = task.parametrization(policy)
    shift = sum(task.rough_errors(parametrization).correction(task.error(TOSS), 1.0))
    moved = parametrization.scale * shift
    amplitude, tempo, wrist_amplitude = (moved[parametrization.groups[n]][0] for n in NAMES)
    assert APEX_OF_AMPLITUDE * (amplitude + tempo) == pytest.approx(-0.1)
    turn = TURN_OF_AMPLITUDE * amplitude + TURN_OF_TEMPO * tempo
    assert turn + TURN_OF_WRIST * wrist_amplitude < 1e-9
    lower, _ = parametrization.policy(shift, "new")
    found = run_of(FLIP, TOSS, {"apex": 0.5})
    np.testing.assert_allclose(found.attractors, lower.attractors)
    assert found.basis.duration == pytest.approx(lower.basis.duration)
    same = run_of(FLIP, {**TOSS, "apex": 0.5}, {"apex": 0.5})
    np.testing.assert_allclose(same.attractors, policy.attractors, atol=1e-12)
