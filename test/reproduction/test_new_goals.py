# SPDX-License-Identifier: Apache-2.0
"""The study of new goals: every way begins with the same goals, and its statistics."""

import numpy as np
import pytest

from reproduction.studies import new_goals
from wam_power_ros.learning.policy import with_id
from wam_power_ros.tasks.ball_in_cup.task import BallInCup


def test_a_session_that_predicts_begins_with_a_success_where_its_policy_as_it_is_does_not() -> None:
    found = new_goals.session("reach", 1)
    assert found["goal"] == {"y": 0.15} and set(found) == {"goal", *new_goals.WAYS}
    assert found["origin"]["confirmed"]
    assert found["predicted"]["first"] == 1 < found["carried over"]["first"]
    assert found == new_goals.session("reach", 1)


def test_a_session_without_a_success_counts_as_one_that_never_succeeded() -> None:
    one = {"first": 3, "used": 9, "confirmed": 4, "successes": 20}
    never = {"first": None, "used": 60, "confirmed": 0, "successes": 0}
    found = new_goals.line([one, never, None])
    assert (found["sessions"], found["begun"]) == (3, 2)
    assert found["first success"] == [3.0, 3.0, np.inf]
    assert (found["confirmed"], found["robust"], found["first rollout succeeds"]) == (1, 1, 0)


def test_a_ball_hangs_on_the_string_of_the_goal_and_a_swing_is_scaled_to_it() -> None:
    there = new_goals.place("ball_in_cup", 1, {"string": 0.3})
    (shown,) = new_goals.taught("ball_in_cup", 1, there)
    policy = BallInCup.policy_of([shown], "demonstration-1")
    task = new_goals.preset("ball_in_cup").make_task({"goal": {"string": 0.3}})
    scaled = with_id(task.carried(policy, {"string": 0.4}), "scaled")
    rollout, _ = there.run(scaled)
    hanging = rollout.body.position[0] - rollout.tool.position[0]
    assert np.linalg.norm(hanging) == pytest.approx(0.3, abs=0.01)
    assert task.assess(scaled, rollout).observation["apex"] > -0.3
