# SPDX-License-Identifier: Apache-2.0
"""What a session learns from: a task's errors, or a return of its own; and that it says which."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from toss_task import demonstrated_policy, practice_of, toss

from wam_power_ros import installed
from wam_power_ros.learning.learner import MeasuringLearner
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.power import Power
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.practice.practice import Practice
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
EXTENDING = Path(__file__).resolve().parents[2] / "docs/extending.md"


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
    assert list(practised.hindsight(Assessment(0.5, {}, seen), parametrization)) == []
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


def test_the_example_of_a_return_of_its_own_learns_otherwise_than_the_flip(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    blocks = re.findall(r"```python\n(.*?)```", EXTENDING.read_text(), re.DOTALL)
    exec(next(block for block in blocks if "class HighFlip" in block), found := {})

    def practised(kind: type[Task]) -> Practice:
        monkeypatch.setattr(installed, "task_type", lambda _: kind)
        settings = preset("flip", budget=8, retests=0)
        practice = practice_of([demonstrated_policy()], settings, 0)
        while (trial := practice.next_trial()) is not None:
            practice.learn_assessed(trial, toss(trial, settings.task_settings))
        return practice

    high, flip = practised(found["HighFlip"]), practised(Flip)
    assert type(high.learner) is Power and high.learner.settings.weights == "sharpened"
    assert all(record.learnt_as == record.z for record in high.records)
    assert high.records[-1].z != flip.records[-1].z
    monkeypatch.setattr(installed, "task_type", lambda _: found["HighFlip"])
    with pytest.raises(ValueError, match="needs a model of the vector error"):
        practice_of([demonstrated_policy()], preset("flip", learner={"name": "model_based"}), 0)


def test_margins_and_models_of_another_return_are_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Success is then counted alone: what was a margin may not be one of that success."""
    flight = {"tossed": True, "seen": True, "angle": 3.1, "landing_error": [0.0, 0.0, 0.0]}
    flight |= {"catch_pitch": 0.0, "climb": 0.0}

    def shown(kind: type[Task]) -> int:
        monkeypatch.setattr(installed, "task_type", lambda _: kind)
        practice = practice_of([demonstrated_policy()], preset("flip", budget=40, retests=0), 0)
        while not practice.stopped:
            trial = practice.next_trial()
            practice.learn_assessed(trial, Assessment(1.0, {}, flight, True))
        return practice.confirmed

    assert shown(Flip) < shown(own_return(Flip)) == preset("flip").practice.confirm
    monkeypatch.undo()


def test_a_correction_by_a_parameter_that_is_not_learnt_is_refused_for_every_learner() -> None:
    """It would be said to the person, and not be made."""
    for learner in ("power", "corrections_only"):
        with pytest.raises(ValueError, match=r"corrects by its effects, .* vigour, sideways"):
            preset("ball_in_cup", "cup", {"name": learner}, variant="attractors").check(1)
    preset("ball_in_cup", "cup", variant="attractors", gain=0.0).check(1)
