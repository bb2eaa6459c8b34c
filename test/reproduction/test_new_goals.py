# SPDX-License-Identifier: Apache-2.0
"""The study of new goals: every way begins with the same goals, and its statistics."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from reproduction.studies import grounds, new_goals
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.reach.task import Reach

ROOT = Path(__file__).resolve().parents[2]


def test_every_goal_is_begun_in_every_way_and_a_prediction_needs_fewer_rollouts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(new_goals, "GOALS", new_goals.GOALS[:2])
    result = new_goals.session(1)
    found = {way: new_goals.line(result[way]) for way in new_goals.WAYS}
    assert {each["sessions"] for each in found.values()} == {2}
    assert found["predicted"]["confirmed"] == 2
    assert found["predicted"]["rollouts"] < found["taught afresh"]["rollouts"]


def test_a_session_without_a_success_counts_as_one_that_never_succeeded() -> None:
    one = {"first": 3, "used": 9, "confirmed": 4, "successes": 20}
    never = {"first": None, "used": 60, "confirmed": 0, "successes": 0}
    found = new_goals.line([one, never, None])
    assert (found["sessions"], found["begun"]) == (3, 2)
    assert found["first success"] == [3.0, 3.0, np.inf]
    assert (found["confirmed"], found["robust"], found["first rollout succeeds"]) == (1, 1, 0)


def test_a_study_run_as_a_module_finds_its_sessions_in_every_worker(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "reproduction.studies.new_goals", "--folder", str(tmp_path)]
    asked = ["--seeds", "1", "--ways", "predicted", "--workers", "2"]
    said = subprocess.run([*command, *asked], cwd=ROOT, capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    assert "predicted: {'sessions': 5" in said.stdout


def test_on_the_arm_a_reach_is_taught_to_its_goal_and_executed_as_far_as_the_obstacle() -> None:
    place = new_goals.SimulatedArm(2)
    goal = (0.78, 0.35, 0.6)
    shown = place.taught(2, goal)
    ends = np.array([each.position[-1] for each in shown])
    assert len(ends) == new_goals.DEMONSTRATIONS
    np.testing.assert_allclose(ends.mean(axis=0), goal, atol=0.03)
    task = Reach(preset("reach").task_settings, Reach.context_of(shown, place.obstacle))
    policy = Reach.policy_of(shown, "demonstration-1")
    rollout = place.executed(task, policy, np.random.default_rng(0))
    assert rollout.fault is None and rollout.stopped_in == place.obstacle.name == "obstacle"
    assert task.assess(policy, rollout).observation["touched"]


def test_every_size_is_begun_in_every_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grounds, "BUDGET", 2)
    monkeypatch.setattr(grounds, "RETESTS", 1)
    result = new_goals.pancakes(1, (0.08,))
    found = new_goals.rows([result, result])
    keys = {f"{way}, 0.08" for way in new_goals.WAYS[1:]}
    assert set(result) == {"origin"} | keys
    assert set(found) == set(result) | set(new_goals.WAYS[1:])
    for way in new_goals.WAYS[1:]:
        assert found[way] == found[f"{way}, 0.08"]
        assert new_goals.line(found[way], 1)["sessions"] == 2
        assert all(each["used"] == 2 for each in found[way])
    carried, afresh = found["carried over"][0], found["taught afresh"][0]
    assert carried != afresh
