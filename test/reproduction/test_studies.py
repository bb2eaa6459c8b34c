# SPDX-License-Identifier: Apache-2.0
"""The command of the studies, and studies of what a person wants."""

import inspect
from pathlib import Path

import numpy as np
import pytest

from reproduction.rivals.learners import RandomSearch
from reproduction.studies import __main__ as studies
from reproduction.studies import equal_knowledge, new_goals, rated
from reproduction.studies.equal_knowledge import InformedLearner, Planner, runs
from wam_power_ros.learning.policy import with_id
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
    assert all(run["left"] < rated.NEAR and run["used"] <= rated.ROLLOUTS for run in found)
    assert rated.line(found)["near"] == 2


def test_a_person_who_rates_at_random_does_not() -> None:
    assert rated.line([rated.session(seed, "shifts", 1.0) for seed in (1, 2)])["left"] > rated.NEAR


def searching(seed: int = 0) -> RandomSearch:
    return RandomSearch(2, RandomSearch.Settings(), np.random.default_rng(seed))


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


def test_with_a_model_the_best_of_its_own_draws_is_tried() -> None:
    drawn = searching()
    expected = np.stack([drawn.ask() for _ in range(equal_knowledge.CANDIDATES)])
    z = InformedLearner(searching(), Hill(), 0.0, np.random.default_rng(9)).ask()
    assert z.tolist() == expected[np.argmin(((expected - 1.0) ** 2).sum(axis=1))].tolist()


def test_noise_reaches_learner_and_model_alike_and_no_return_is_negative() -> None:
    learner, model = searching(), Hill()
    informed = InformedLearner(learner, model, 0.5, np.random.default_rng(9))
    for _ in range(50):
        informed.tell(np.zeros(2), 0.1)
    assert learner._rollouts.returns.tolist() == model.returns
    assert min(model.returns) == 0.0 and np.std(model.returns) > 0.1


def test_the_planner_tries_what_the_model_says_is_best() -> None:
    planner = Planner(2, np.random.default_rng(0), Hill())
    assert planner.ask() == pytest.approx([1.0, 1.0], abs=0.1)


@pytest.mark.parametrize("row", ["nothing", "power+model"])
def test_a_row_is_a_function_of_its_seeds(row: str) -> None:
    (one, again), other = (runs(row, 0.02, [1], 3) for _ in range(2)), runs(row, 0.02, [2], 3)
    assert one == again
    assert (one == other) == (row == "nothing")
