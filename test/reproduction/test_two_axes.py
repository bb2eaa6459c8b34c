# SPDX-License-Identifier: Apache-2.0
"""The planner told less: what the rivals of the two axes do, and the figures of their sessions."""

import numpy as np
import pytest

from reproduction.rivals.slopes import ALONE, FIXED, SHARPENED, LessInformed, Newton
from reproduction.studies import two_axes
from wam_power_ros.learning.learner import Prediction
from wam_power_ros.learning.model_based import ModelBased
from wam_power_ros.tasks.errors import RoughErrors

SIZE, DIRECTIONS = 3, np.eye(3)[:2]
TARGET = np.array([1.5, -1.0])


def a_model(predicts: bool = True) -> RoughErrors:
    """Two errors of five tolerances a step, of which the true slopes are 60 %."""
    model = object.__new__(RoughErrors)
    model.directions, model.slopes = DIRECTIONS, 5.0 * np.eye(2)
    model.modes = np.empty((0, DIRECTIONS.shape[1]))
    if predicts:
        model.predict = lambda z: Prediction(3.0 * (z[:2] - TARGET), np.empty(0))
    return model


def true_error(z: np.ndarray) -> np.ndarray:
    return 3.0 * (z[:2] - TARGET)


def errors_of(learner: LessInformed | Newton, rollouts: int) -> list[float]:
    found = []
    for _ in range(rollouts):
        z = learner.ask()
        learner.measure(z, true_error(z))
        learner.tell(z, 0.1)
        found.append(float(np.abs(true_error(z)).max()))
    return found


def less_informed(**settings: object) -> LessInformed:
    given = LessInformed.Settings.model_validate(settings)
    return LessInformed(SIZE, given, np.random.default_rng(0), a_model())


def newton() -> Newton:
    model = a_model(predicts=False)
    return Newton(SIZE, Newton.Settings(), np.random.default_rng(0), model)


def test_the_better_informed_is_nearer_after_as_many_rollouts() -> None:
    third = [errors_of(less_informed(**known, **ALONE), 3)[-1] for known in ({}, SHARPENED, FIXED)]
    assert third[0] <= 0.5 and third[0] < third[1] < third[2]


def test_all_that_it_may_know_makes_it_the_planner() -> None:
    planner = ModelBased(SIZE, ModelBased.Settings(), np.random.default_rng(0), a_model())
    assert np.array_equal(less_informed().ask(), planner.ask())


def test_newton_takes_the_whole_step_of_the_slopes_and_stays_where_nothing_is_measured() -> None:
    learner = newton()
    assert errors_of(learner, 1) == [4.5]
    assert learner.mean == pytest.approx([0.9, -0.6, 0.0])
    z = np.array([0.2, 0.1, 0.0])
    learner.tell(z, 0.0)
    assert np.array_equal(learner.ask(), z)


def test_a_session_that_is_confirmed_and_fails_its_retests_is_wrong() -> None:
    good = {"first": 2, "rollouts": 8, "confirmed": True, "true": 9, "retests": 10}
    found = two_axes.line([good, {**good, "true": 8}, {**good, "first": None, "confirmed": False}])
    assert (found["solved"], found["confirmed"], found["wrong"]) == (2, 2, 1)
    assert found["first success"] == 2.0 and found["rollouts"] == [8.0, 8.0]
