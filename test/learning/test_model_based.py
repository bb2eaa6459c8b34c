# SPDX-License-Identifier: Apache-2.0
"""Planning on a model of a vector error that may be wrong."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hill_task import rng

from wam_power_ros.learning.learner import Prediction
from wam_power_ros.learning.model_based import PROBE_STEP, ModelBased
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
    modes = np.eye(SIZE)[-2:]

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


@pytest.mark.parametrize("limit", [5.0, 7.5])
def test_steps_go_along_a_limit_and_not_over_it(limit: float) -> None:
    settings = ModelBased.Settings(simulations=12)
    learner = ModelBased(SIZE, settings, rng(0), LinearModel(limit=limit))
    practise(learner, 1)
    assert 0.95 * limit < np.linalg.norm(learner.mean) < limit


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


def test_a_plan_is_asked_for_as_it_is_and_again_where_nothing_was_measured() -> None:
    learner = learner_of(LinearModel())
    assert np.array_equal(learner.ask(), learner.ask()), "it can be moved nearer to no rollout"
    for _ in range(3):
        practise(learner, 1)
        plan = learner.mean
        assert np.array_equal(learner.ask(), plan)
        assert not np.array_equal(learner.ask(), plan)


def test_where_a_rejected_plan_has_come_back_to_the_best_rollout_power_draws() -> None:
    learner = learner_of(LinearModel(), seed=3)
    practise(learner, 1)
    asked = [learner.ask() for _ in range(40)]
    on_the_way = [np.allclose(z, 0.8**k * asked[0]) for k, z in enumerate(asked)]
    assert all(on_the_way[:5]) and not any(on_the_way[25:])
    assert min(np.linalg.norm(z) for z in asked) > 0.3, "never the rollout again"


def told(z: np.ndarray, error: np.ndarray, uncertain: float = 0.0) -> Prediction:
    """A prediction far within the limits of the arm."""
    return Prediction(error, np.array([-1.0]), np.full((len(error), 1), uncertain))


class Landscape(LinearModel):
    """An error model that predicts by a function of the coordinates."""

    def __init__(self, predict: Callable[[np.ndarray], Prediction]) -> None:
        super().__init__()
        self.predict = predict


def test_a_plan_keeps_away_from_where_what_a_prediction_assumes_decides() -> None:
    """On the edge of a throw that comes off, a slightly larger drag means that it does not."""

    def predicted(z: np.ndarray) -> Prediction:
        return told(z, error(z), uncertain=6.0 if z[0] > 5.0 else 0.1)

    free = practise(learner_of(LinearModel()), 2)[-1]
    assert np.abs(free).max() < 0.5
    careful = learner_of(Landscape(predicted))
    practise(careful, 1)
    assert careful.mean[0] <= 5.0, "without the edge it is 6.3"
    assert np.abs(error(careful.mean)).max() < 2.0, "the other directions do what the first did"
    shown = np.array([5.5, 0.0, 0.0, *np.zeros(SIZE - 3)])
    tell(careful, shown, error(shown))
    assert careful.mean[0] > 5.0, "a rollout there has shown what is true"


def test_from_a_valley_without_a_way_on_evolution_finds_a_deeper_one() -> None:
    """Steps end in the nearest valley, as of a movement that hardly throws."""

    def valleys(z: np.ndarray) -> np.ndarray:
        here, there = np.abs(z).max(), abs(abs(z[-1]) - 2.3)
        return np.array([min(4.0 + here, 4.0 * there), 0.0])

    for simulations in (160, ModelBased.Settings().simulations):  # of the former steps need some
        settings = ModelBased.Settings(simulations=simulations)
        learner = ModelBased(SIZE, settings, rng(0), Landscape(lambda z: told(z, valleys(z))))
        assert practise(learner, 1, valleys)[0].tolist() == [4.0, 0.0]
        assert valleys(learner.mean)[0] < 1.0


def test_where_the_directions_of_the_model_do_not_suffice_the_other_coordinates_are_searched() -> (
    None
):
    def bent(z: np.ndarray) -> np.ndarray:
        return np.array([4.0 - z[3], 0.2 * z[0]])  # neither direction nor mode

    learner = learner_of(Landscape(lambda z: told(z, bent(z))))
    practise(learner, 1, bent)
    assert np.abs(bent(learner.mean)).max() < 1.0


def test_a_plan_that_is_foreseen_to_be_worse_than_a_rollout_is_not_run() -> None:
    def bowl(z: np.ndarray) -> np.ndarray:
        return np.array([4.0 + np.linalg.norm(z), 0.0])

    learner = learner_of(Landscape(lambda z: told(z, bowl(z))))
    practise(learner, 1, bowl)
    assert learner.falls_back


def test_a_plan_keeps_a_limit_that_the_best_point_hardly_exceeds() -> None:
    def predicted(z: np.ndarray) -> Prediction:
        beyond = np.abs(error(z)).max() < 1.0
        return Prediction(error(z), np.array([0.001 if beyond else -1.0]))

    model = Landscape(predicted)
    learner = learner_of(model)
    practise(learner, 1)
    assert model.predict(learner.mean).limit_excess[0] < 0.0


def test_steps_lead_away_from_what_an_assumed_number_changes_much() -> None:
    model = Landscape(lambda z: told(z, error(z), uncertain=z[0]))
    learner = ModelBased(SIZE, ModelBased.Settings(simulations=12), rng(0), model)
    practise(learner, 1)
    assert abs(learner.mean[0]) < 1.5 and np.abs(error(learner.mean)).max() < 2.0


def test_without_a_prediction_nothing_evolves() -> None:
    model = LinearModel(slopes=0.0 * SLOPES)
    model.predict = None
    learner = learner_of(model)
    practise(learner, 1)
    assert learner.falls_back


def test_between_two_rollouts_of_the_same_coordinates_no_difference_is_believed() -> None:
    """A simulation of contacts changes by leaps; the body that it simulates does not there."""

    def rough(z: np.ndarray) -> np.ndarray:
        return np.array([5.0 * (np.abs(z).max() < 0.1), 0.0])

    learner = learner_of(Landscape(lambda z: told(z, rough(z))))
    practise(learner, 1, lambda z: np.array([5.0, 0.0]))
    assert not learner.falls_back and np.linalg.norm(learner.mean) / 5.0 >= PROBE_STEP


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
