# SPDX-License-Identifier: Apache-2.0
"""Planning on a model of a vector error that may be wrong."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hill_task import rng

from wam_power_ros.learning.learner import Prediction
from wam_power_ros.learning.model_based import ModelBased
from wam_power_ros.learning.power import Power

SIZE = 8
SLOPES = np.array([[3.0, 2.0, 0.0], [0.5, 0.0, -4.0]])  # of the error, by direction
START = np.array([-6.0, 5.0])  # error at z = 0


def error(z: np.ndarray) -> np.ndarray:
    """True error of a rollout: linear, and the coordinates beyond the third do not matter."""
    return START + SLOPES @ z[:3] / 5.0


class LinearModel:
    """An error model of a linear task, which counts its predictions."""

    directions = 5.0 * np.eye(3, SIZE)

    def __init__(
        self,
        predicted: Callable[[np.ndarray], np.ndarray] = error,
        slopes: np.ndarray = SLOPES,
        limit: float = math.inf,
    ) -> None:
        self._predicted, self.slopes, self._limit = predicted, slopes, limit
        self.count = 0

    def predict(self, z: np.ndarray) -> Prediction | None:
        """Predict the error; the excess is that of the distance from the start."""
        self.count += 1
        return Prediction(self._predicted(z), np.array([np.linalg.norm(z) / self._limit - 1.0]))


def learner_of(model: LinearModel, seed: int = 0, patience: int = 8) -> ModelBased:
    return ModelBased(SIZE, ModelBased.Settings(patience=patience), rng(seed), model)


def tell(learner: ModelBased, z: np.ndarray, error: np.ndarray, ret: float = 0.5) -> None:
    learner.measure(z, error)
    learner.tell(z, ret)


def practise(
    learner: ModelBased, rollouts: int, true: Callable[[np.ndarray], np.ndarray] = error
) -> list[np.ndarray]:
    """Rollout at z = 0, then at what the learner asks for; returns the true errors."""
    found = []
    for number in range(rollouts):
        z = np.zeros(SIZE) if number == 0 else learner.ask()
        measured = true(z)
        found.append(measured)
        ret = float(np.exp(-0.01 * (np.nan_to_num(measured, nan=9.0) ** 2).sum()))
        tell(learner, z, measured, ret)
    return found


@pytest.mark.parametrize(
    ("model", "predicts", "rollouts"),
    [
        (LinearModel(), True, 2),  # exact
        (LinearModel(lambda z: error(z) + np.array([4.0, -3.0])), True, 3),  # off by a constant
        (LinearModel(slopes=SLOPES * [-0.5, 1.0, 0.5]), True, 3),
        (LinearModel(slopes=0.6 * SLOPES), False, 6),
        (LinearModel(slopes=1.8 * SLOPES), False, 6),
    ],
)
def test_a_plan_is_within_the_tolerances_after_few_rollouts_however_rough_the_model(
    model: LinearModel, predicts: bool, rollouts: int
) -> None:
    if not predicts:
        model.predict = None
    errors = practise(learner_of(model), rollouts)
    assert np.abs(errors[0]).max() > 4.0
    assert min(np.abs(error).max() for error in errors[1:]) < 1.0


def test_a_plan_keeps_the_limits_of_the_arm() -> None:
    model = LinearModel(limit=7.0)  # without it, plans are 8 away
    free, bound = learner_of(LinearModel()), learner_of(model)
    practise(free, 4)
    practise(bound, 4)
    assert np.linalg.norm(free.mean) > 7.0
    assert np.linalg.norm(bound.mean) < 7.0


def test_a_rollout_that_a_fault_ended_moves_the_plan_away_from_the_limits() -> None:
    learner = learner_of(LinearModel(limit=7.0))
    practise(learner, 3)
    before = np.linalg.norm(learner.mean)
    for _ in range(3):
        learner.tell(learner.ask(), 0.0)  # nothing was measured
    assert np.isnan(learner._errors[3:]).all(), "beyond each is an edge"
    assert np.linalg.norm(learner.mean) < 0.97 * before


def lost(_: np.ndarray) -> np.ndarray:
    """Error of a rollout of which a part has no value."""
    return np.array([-12.0, math.nan])


def test_without_a_foreseen_value_power_decides() -> None:
    learner = learner_of(LinearModel(lost), seed=3)
    practise(learner, 1, lost)
    assert learner.falls_back
    power = Power(SIZE, ModelBased.Settings().fallback, rng(3))
    power.tell(np.zeros(SIZE), 1.0)
    np.testing.assert_array_equal(learner.ask(), power.ask())


@pytest.mark.parametrize(("error", "gives_up"), [(9.0, True), (0.8, False)])
def test_without_progress_power_decides_unless_the_error_is_within_the_tolerances(
    error: float, gives_up: bool
) -> None:
    model = LinearModel() if gives_up else LinearModel(lambda z: np.full(2, error))
    learner = learner_of(model, patience=4)
    practise(learner, 4, lambda z: np.full(2, error))
    assert not learner.falls_back
    practise(learner, 1, lambda z: np.full(2, error))
    assert learner.falls_back is gives_up


def test_power_decides_when_what_the_model_foresees_is_not_seen() -> None:
    learner = learner_of(LinearModel(), patience=4)
    practise(learner, 3, lost)
    assert not learner.falls_back
    practise(learner, 4, lost)
    assert learner.falls_back
    tell(learner, np.full(SIZE, 0.5), np.array([3.0, 3.0]))
    assert not learner.falls_back, "a measured value is something to plan from"


def test_a_rollout_beyond_an_edge_halves_the_way_of_the_next_plan() -> None:
    """Beyond it there is no error with a value, as of a ball that the cameras lose."""

    def with_an_edge(z: np.ndarray) -> np.ndarray:
        return error(z) if z[0] < 3.0 else np.full(2, math.nan)

    learner = learner_of(LinearModel())
    errors = practise(learner, 8, with_an_edge)
    beyond = [bool(np.isnan(each).any()) for each in errors]
    assert beyond[1], "the model does not know the edge"
    assert not all(beyond[1:5]), "an eighth of the way is on this side of it"
    best = min(np.abs(each).max() for each in errors)  # NaN is no minimum
    assert best < 0.8 * np.abs(errors[0]).max()


def test_power_decides_when_no_better_plan_is_found_than_one_that_was_run() -> None:
    """At the limits of the arm the best plan is the same again; another rollout tells no more."""
    learner = learner_of(LinearModel(limit=0.3))
    practise(learner, 1)
    assert learner.falls_back
    near = learner_of(LinearModel())
    for measured in (np.array([0.3, 0.3]), np.array([-0.2, 0.1])):
        tell(near, np.zeros(SIZE), measured, 1.0)
    assert not near.falls_back, "what is within the tolerances is run again"


def test_where_a_rejected_plan_has_come_back_to_the_best_rollout_power_draws() -> None:
    learner = learner_of(LinearModel(), seed=3)
    practise(learner, 1)
    asked = [learner.ask() for _ in range(40)]
    on_the_way = [np.allclose(z, 0.8**k * asked[0]) for k, z in enumerate(asked)]
    assert all(on_the_way[:5]) and not any(on_the_way[25:])
    assert min(np.linalg.norm(z) for z in asked) > 0.3, "never the rollout again"


def test_a_learner_without_error_model_is_refused() -> None:
    with pytest.raises(ValueError, match="ModelBased needs a model"):
        ModelBased(SIZE, ModelBased.Settings(), rng(0))


def test_a_rollout_without_an_error_counts_as_beyond_an_edge_only_if_it_earned_nothing() -> None:
    learner = learner_of(LinearModel())
    learner.tell(np.zeros(SIZE), 0.5)  # not seen
    assert learner._errors.shape == (0, 2) and learner._faults == 0
    learner.tell(np.zeros(SIZE), 0.0)
    assert np.isnan(learner._errors).all() and learner._errors.shape == (1, 2)
    tell(learner, np.zeros(SIZE), START, 0.0)
    assert learner._faults == 1 and learner._errors[1].tolist() == START.tolist()


def test_a_plan_takes_no_more_simulations_than_are_set() -> None:
    for simulations in (1, 3):
        model = LinearModel(limit=5.0)
        settings = ModelBased.Settings(simulations=simulations)
        learner = ModelBased(SIZE, settings, rng(0), model)
        practise(learner, 1)
        assert learner.mean.shape == (SIZE,)
        assert model.count == 1 + simulations


@pytest.mark.parametrize(
    "bent", [lambda e: e + 0.2 * e**3, lambda e: 4.0 * np.sign(e) * np.sqrt(np.abs(e))]
)
def test_steps_that_overshoot_are_shortened_until_the_prediction_is_nearly_zero(
    bent: Callable[[np.ndarray], np.ndarray],
) -> None:
    model = LinearModel(lambda z: bent(error(z)))
    learner = learner_of(model)
    practise(learner, 1, lambda z: bent(error(z)))
    assert np.abs(bent(error(learner.mean))).max() < 0.5
    assert model.count < ModelBased.Settings().simulations, "it has found enough"
