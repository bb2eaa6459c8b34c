# SPDX-License-Identifier: Apache-2.0
"""Sessions of a learner that plans on a model of the vector error."""

from __future__ import annotations

import math

import numpy as np
import pytest
from toss_task import demonstrated_policy, practice_of, toss

from wam_power_ros.learning.learner import Prediction
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks import task as task_module
from wam_power_ros.tasks.flip.parametrization import TURN_OF_AMPLITUDE, TURN_OF_TEMPO, TURN_OF_WRIST
from wam_power_ros.tasks.flip.toss_errors import ERRORS

SETTINGS = preset("flip", "model_based", budget=12, retests=2, confirm=3)
CANDIDATES = [demonstrated_policy()]


def predict(z: np.ndarray) -> Prediction:
    """Error of `toss`, without its noise and with a rotation that is 0.3 rad off."""
    noise = SETTINGS.task_settings.noise
    turn = TURN_OF_AMPLITUDE * noise.amplitude * z[-4]
    turn += TURN_OF_WRIST * noise.wrist_amplitude * z[-3]
    turn += TURN_OF_TEMPO * noise.tempo * z[-1]
    error = [1.9 + turn - math.pi, 0.12 - noise.catch_shift * z[-2], 0.0, 0.0]
    tolerances = [each.tolerance for each in ERRORS[:4]]
    return Prediction(np.array(error) / tolerances, np.array([-0.5]))


@pytest.fixture(autouse=True)
def _known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(task_module, "predictor", lambda *known: predict)


def practised(practice: Practice) -> Practice:
    while (trial := practice.next_trial()) is not None:
        practice.learn_assessed(trial, toss(trial, practice.task.settings, noise=0.02))
    return practice


def test_a_plan_is_run_as_the_mean_so_its_success_counts_at_once() -> None:
    practice = practised(practice_of(CANDIDATES, SETTINGS, 0))
    kinds = [record.kind for record in practice.records if record.kind != "retest"]
    assert kinds[0] == "reproduction" and set(kinds[1:]) == {"mean"}
    assert "3 of 3 succeeded" in practice.stopped
    assert practice.used <= 6


def test_a_session_resumed_after_any_line_plans_the_same() -> None:
    log = practised(practice_of(CANDIDATES, SETTINGS, 1)).log
    for kept in range(len(log)):
        again = practice_of(CANDIDATES, SETTINGS, 1, log[:kept])
        trial = again.next_trial()
        assert trial.z.tolist() == log[kept].z and trial.kind == log[kept].kind


def test_the_error_is_that_of_what_was_executed_not_of_the_correction_in_hindsight() -> None:
    practice = practice_of(CANDIDATES, SETTINGS, 0)
    for _ in range(3):
        trial = practice.next_trial()
        practice.learn_assessed(trial, toss(trial, practice.task.settings))
    learner = practice.learner
    assert learner._z.tolist() == [record.z for record in practice.records]
    assert any(record.z_corrected != record.z for record in practice.records)
    for error, record in zip(learner._errors, practice.records, strict=True):
        angle = (record.observation["angle"] - math.pi) / ERRORS[0].tolerance
        np.testing.assert_allclose(error[0], angle)


def test_once_a_person_has_rated_a_rollout_returns_count_and_not_the_measured_error() -> None:
    """The plan would be the same again: a rating changes no error."""
    rated, plain = (practice_of(CANDIDATES, SETTINGS, 0) for _ in range(2))
    for practice in (rated, plain):
        practice.learn_assessed(trial := practice.next_trial(), toss(trial, SETTINGS.task_settings))
    rated.rate(-0.1)
    assert plain.next_trial().kind == "mean" and not plain.learner.falls_back
    assert rated.next_trial().kind == "explore" and rated.learner.falls_back
    trial = rated.next_trial()
    rated.learn_assessed(trial, toss(trial, SETTINGS.task_settings))
    assert rated.learner.falls_back, "for the rest of the session"
    again = practice_of(CANDIDATES, SETTINGS, 0, rated.log)
    assert again.next_trial().z.tolist() == rated.next_trial().z.tolist()
