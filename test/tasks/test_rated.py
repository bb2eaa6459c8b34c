# SPDX-License-Identifier: Apache-2.0
"""The task that a person alone judges: ratings, what needs none, and where it is refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from conftest import lift
from toss_task import ANY_ARM

from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.rollout import EndEffectorPath, Rollout
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.rated import Rated, assessed

POLICY = lift("demonstration-1")


def rollout(name: str, share: float = 1.0, fault: Fault | None = None) -> Rollout:
    """Tool at rest for a share of the time that a rollout takes."""
    task = preset("rated").make_task({})
    t = np.arange(0.0, share * (POLICY.basis.duration + task.settle_time) + 1e-6, 0.01)
    pose = np.tile([0.5, 0.0, 0.5], (len(t), 1)), np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    return Rollout(EndEffectorPath(name, t, *pose), fault=fault)


def test_a_rating_from_0_to_1_is_the_return_and_the_highest_one_a_success() -> None:
    for value in (0.0, 4.0 / 9.0, 1.0):
        found = assessed(value)
        assert (found.ret, found.success) == (value, value == 1.0)
    for value in (-0.01, 1.01, float("nan")):
        with pytest.raises(ValueError, match="must be from 0"):
            assessed(value)


def test_only_a_rollout_that_ran_to_its_end_awaits_a_rating() -> None:
    practice = Practice(preset("rated"), {}, [POLICY], 0, ANY_ARM)
    trial = practice.next_trial()
    assert practice.awaits_rating(trial, rollout(trial.id))
    assert not practice.awaits_rating(trial, rollout(trial.id, share=0.5))
    fault = Fault(FaultKind.JOINT_SPEED, "joint 2 too fast")
    assert not practice.awaits_rating(trial, rollout(trial.id, fault=fault))
    flip = Practice(preset("flip"), {}, [POLICY], 0, ANY_ARM)
    assert not flip.awaits_rating(trial := flip.next_trial(), rollout(trial.id))


def test_without_a_rating_there_is_no_return_and_after_a_fault_of_the_policy_one_of_0() -> None:
    task = preset("rated").make_task({})
    assert isinstance(task, Rated)
    assert task.assess(POLICY, rollout(POLICY.id)).why == "not rated by a person"
    assert "cut short" in task.assess(POLICY, rollout(POLICY.id, share=0.5)).why
    fault = Fault(FaultKind.JOINT_SPEED, "joint 2 too fast")
    assert task.assess(POLICY, rollout(POLICY.id, fault=fault)).ret == 0.0


def test_a_session_without_a_person_is_refused(refusal: Callable[..., str]) -> None:
    said = refusal("learn", "--in-process", "--task", "rated", "--session", "s")
    assert "a person rates the task rated" in said
