# SPDX-License-Identifier: Apache-2.0
"""The studies: their command, what a person wants, grounds of the flip, the ball in the cup."""

import inspect
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reproduction.rivals.learners import RIVALS
from reproduction.studies import __main__ as studies
from reproduction.studies import ball_in_cup, equal_knowledge, grounds, new_goals, rated
from reproduction.studies.equal_knowledge import Planner, runs
from reproduction.studies.flip_sessions import HELD_OUT, stand_in, teach
from wam_power_ros.learning.policy import with_id
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.ball_in_cup.task import BallInCup


@pytest.mark.parametrize("name", studies.STUDIES)
def test_every_learner_at_every_place_has_runs_of_its_own(name: str) -> None:
    table = studies.STUDIES[name]
    jobs = table.jobs([1, 2], [*table.places], [*table.learners])
    assert len({job.name for job in jobs}) == len(jobs)
    assert len({job.study for job in jobs}) == len(table.places) * len(table.learners)
    for job in jobs:
        inspect.signature(job.function).bind(**job.arguments)


def test_a_study_prints_what_each_learner_is_told_and_its_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(equal_knowledge.NOISES["noisy returns"], "rollouts", 2)
    words = ["equal_knowledge", "--only", "noisy returns", "--learners", "nothing", "power"]
    studies.main([*words, "--seeds", "2", "--folder", str(tmp_path)])
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("noisy returns, nothing (learns from nothing: the demonstration): {")
    assert second.startswith("noisy returns, power (learns from return): {'mean': 0.")


def test_a_session_that_predicts_begins_with_a_success_where_its_policy_as_it_is_does_not() -> None:
    found = {way: new_goals.session(1, "reach", way) for way in new_goals.WAYS}
    assert found["origin"]["confirmed"]
    assert found["predicted"]["first"] == 1 < found["carried over"]["first"]
    new_goals.known.cache_clear()
    assert found["predicted"] == new_goals.session(1, "reach", "predicted")


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


def test_ratings_bring_the_end_of_a_movement_near_where_a_person_wants_it() -> None:
    found = [rated.session(seed, "shifts", 0.0) for seed in (1, 2)]
    assert all(run["left"] < rated.NEAR_MISS and run["used"] <= rated.ROLLOUTS for run in found)
    assert rated.line(found)["near"] == 2


class Hill:
    """A model that knows the optimum and records the returns it gets."""

    def __init__(self) -> None:
        self.returns: list[float] = []

    def predict(self, z: np.ndarray) -> np.ndarray:
        """See `Model`."""
        return -((z - 1.0) ** 2).sum(axis=1)

    def learn(self, z: np.ndarray, ret: float) -> None:
        """See `Model`."""
        self.returns.append(ret)


def test_the_planner_tries_what_the_model_says_is_best() -> None:
    planner = Planner(2, np.random.default_rng(0), Hill())
    assert planner.ask() == pytest.approx([1.0, 1.0], abs=0.1)


@pytest.mark.parametrize("row", ["nothing", "power+model"])
def test_a_row_is_a_function_of_its_seeds(row: str) -> None:
    (one, again), other = (runs(row, 0.02, [1], 3) for _ in range(2)), runs(row, 0.02, [2], 3)
    assert one == again
    assert (one == other) == (row == "nothing")


def test_learners_of_a_ground_differ_only_in_the_learner_and_what_it_is_told() -> None:
    assert not {7001, grounds.FIRST} & set(HELD_OUT)
    found = grounds.TABLE.jobs([1], ["novice"], list(grounds.LEARNERS))
    own = {"task_settings", "learner", "learner_settings", "practice"}
    blank = {"name": "", "changes": 0}
    searched = ("model_based", "hindsight", "power")
    plain = preset("flip", "hindsight", **found[0].arguments["changes"])
    for job, (learner, row) in zip(found, grounds.LEARNERS.items(), strict=True):
        assert {**job.arguments, **blank} == {**found[0].arguments, **blank}
        settings = preset("flip", job.arguments["name"], **job.arguments["changes"])
        assert settings.model_dump(exclude=own) == plain.model_dump(exclude=own)
        assert settings.practice.budget == plain.practice.budget
        assert settings.practice.retests == plain.practice.retests
        assert learner not in searched or settings.practice == plain.practice
        named = job.arguments["changes"].get("learner")
        assert named in (None, {"name": RIVALS.get(learner, learner)})
        task = settings.task_settings
        blind = not task.gain
        assert ("rotation" in row.told) == (not blind)


def test_a_habit_changes_the_demonstration() -> None:
    plain, twisted, slow = (
        teach(stand_in(1), 1, 1, habit=each)[0] for each in ("", "late twist", "slow")
    )
    usual = 1.15 * plain.basis.duration
    assert twisted.basis.duration <= usual < slow.basis.duration
    assert not np.allclose(twisted.rotation_attractors, plain.rotation_attractors, atol=0.02)


def a_session(true: int, ended_by: str, used: int, landed: int = 30) -> dict[str, Any]:
    return {
        "carried": {},
        "used": used,
        "ended_by": ended_by,
        "retests": [{"true_flip": k < true, "landed": k < landed} for k in range(30)],
    }


def test_the_statistics_of_a_row_count_sessions_and_not_rollouts() -> None:
    sessions = [
        a_session(30, "confirmation", 20),
        a_session(27, "confirmation", 30),
        a_session(24, "confirmation", 50),
        a_session(0, "budget", 60, landed=26),
    ]
    found = grounds.line(sessions)
    assert found["landed"] == 3  # turned over and caught, however far in the air
    assert (found["sessions"], found["solved"], found["confirmed"]) == (4, 2, 3)
    assert found["wrong"] == 1 and found["rollouts"] == (40.0, 60.0)
    assert found["true"][0] == 0.675 and 0.0 <= found["true"][1] < 0.3


def a_swing_session(
    caught: int, used: int, confirmed: bool, first: float | None = 0.2
) -> dict[str, Any]:
    retests = [{"kind": "retest", "caught": k < caught} for k in range(30)]
    first_one = {"kind": "reproduction", "distance": first, "caught": False}
    return {"used": used, "confirmed": confirmed, "trials": [first_one, *retests]}


def test_the_statistics_of_swings_count_sessions_and_not_rollouts() -> None:
    found = ball_in_cup.line(
        [
            a_swing_session(30, 18, True, first=0.04),
            a_swing_session(27, 28, True),
            a_swing_session(26, 38, True, first=None),
            a_swing_session(0, 75, False),
        ]
    )
    assert (found["sessions"], found["near"], found["solved"]) == (4, 1, 2)
    assert found["confirmed"] == 3 and found["rollouts"] == [33.0, 18.0, 75.0]
