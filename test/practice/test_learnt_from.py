# SPDX-License-Identifier: Apache-2.0
"""What a session learns from: a task's errors, or a return of its own; and that it says which."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from toss_task import demonstrated_policy

from wam_power_ros import installed
from wam_power_ros.learning.learner import MeasuringLearner
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.ball_in_cup.task import BallInCup
from wam_power_ros.tasks.errors import Effect, Error
from wam_power_ros.tasks.flip.task import Flip
from wam_power_ros.tasks.reach.task import Reach
from wam_power_ros.tasks.task import Assessment, Task

TASKS: list[type[Task]] = [Flip, BallInCup, Reach]
CASES = [(task, name) for task in TASKS for name in task.presets]
OWN = (Error("height", "m", 0.1),)
CONTEXT = {
    "demonstrated": [[0.6, 0.0, 0.5], [0.65, 0.0, 0.5], [0.7, 0.0, 0.5]],
    "obstacle": [0.0] * 4,
}


def own_return(task: type[Task]) -> type[Task]:
    """A task with another return."""

    def assess(self: Task, policy: object, rollout: object) -> Assessment:
        return Assessment(1.0)

    return type("Own", (task,), {"assess": assess})


def own_success(task: type[Task]) -> type[Task]:
    """A task with the same return and another success."""

    def assess(self: Task, policy: Policy, rollout: Rollout) -> Assessment:
        known = task.assess(self, policy, rollout)
        return Assessment(known.ret, known.terms, known.observation, False, known.why)

    return type("Own", (task,), {"assess": assess})


def own_errors(task: type[Task], **more: object) -> type[Task]:
    """A task with other errors, which its return may be of as well."""
    effects = (Effect(task.effects[0].group if task.effects else "shift_x", 0.1, {"height": 1.0}),)
    members = {"errors": OWN, "effects": effects, "measure": lambda self, seen: seen}
    return type("Own", (task,), {**members, **more})


def said(monkeypatch: pytest.MonkeyPatch, kind: type[Task], name: str) -> tuple[str, Task]:
    """First line of a session of a preset, and its task."""
    monkeypatch.setattr(installed, "task_type", lambda _: kind)
    settings = preset(kind.name, name)
    task = settings.make_task(CONTEXT)
    return settings.described(task).rpartition("learns from ")[2], task


@pytest.mark.parametrize("changed", [own_return, own_success])
@pytest.mark.parametrize(("task", "name"), CASES)
def test_a_return_of_its_own_is_learnt_from_and_said_or_refused(
    changed: Callable[[type[Task]], type[Task]],
    task: type[Task],
    name: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kind = changed(task)
    if name == "corrections_only":
        with pytest.raises(ValueError, match="'corrections_only' learns from errors, task"):
            monkeypatch.setattr(installed, "task_type", lambda _: kind)
            preset(kind.name, name).make_learner(4, np.random.default_rng(0))
        return
    told, practised = said(monkeypatch, kind, name)
    assert told == "the return"
    seen = {"height": 0.1}
    assert practised.error(seen) is None and not practised.corrections
    parametrization = practised.parametrization(demonstrated_policy(count=16))
    assert list(practised.error_correction(Assessment(0.5, {}, seen), parametrization)) == []
    learner = installed.find("learner", preset(kind.name, name).learner)
    assert not issubclass(learner, MeasuringLearner)


@pytest.mark.parametrize(("task", "name"), CASES)
def test_errors_of_its_own_are_learnt_from_and_said(
    task: type[Task], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assess = vars(own_return(task))["assess"]
    for kind in (own_errors(task), own_errors(task, assess=assess)):
        told, practised = said(monkeypatch, kind, name)
        assert practised.error({"height": 0.3}) == pytest.approx([3.0])
        learner = preset(kind.name, name).learner
        if learner in ("model_based", "corrections_only"):
            assert told == "height"
        else:
            assert told == "the return" + (", corrected by height" if practised.gain else "")


def test_a_correction_by_a_parameter_that_is_not_learnt_is_refused_for_every_learner() -> None:
    """It would be said to the person, and not be made."""
    for learner in ("power", "corrections_only"):
        with pytest.raises(ValueError, match=r"corrects by its effects, .* amplitude, sideways"):
            preset("ball_in_cup", "cup", {"name": learner}, variant="attractors").check(1)
    preset("ball_in_cup", "cup", variant="attractors", gain=0.0).check(1)
