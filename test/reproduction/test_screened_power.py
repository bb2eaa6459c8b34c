# SPDX-License-Identifier: Apache-2.0
"""PoWER with model-based screening."""

import numpy as np
from hill_task import SIZE, CrudeModel, climb, hill, rng

from reproduction.rivals.learners import ScreenedPower
from wam_power_ros.learning.power import Power

Settings = ScreenedPower.Settings


def test_the_candidate_of_highest_predicted_return_is_executed() -> None:
    model = CrudeModel()
    learner = ScreenedPower(SIZE, Settings(candidates=50), rng(7), model)
    candidates = rng(7).standard_normal((50, SIZE))  # the mean is still zero
    best = candidates[np.argmax(model.predict(candidates))]
    np.testing.assert_array_equal(learner.ask(), best)


def test_the_number_of_candidates_decreases_with_the_number_of_rollouts() -> None:
    asked: list[int] = []

    class Counting(CrudeModel):
        def predict(self, z: np.ndarray) -> np.ndarray:
            asked.append(len(z))
            return super().predict(z)

    climb(ScreenedPower(SIZE, Settings(candidates=16, half_life=2), rng(1), Counting()), 12)
    assert asked == [16, 11, 8, 6, 4, 3, 2]  # then a single candidate, which needs no prediction


def test_with_one_candidate_it_is_power() -> None:
    settings = Settings(candidates=1, sigma=3, decay=0.97)
    screened = climb(ScreenedPower(SIZE, settings, rng(5), CrudeModel()), 40)
    power = climb(Power(SIZE, Power.Settings(sigma=3, decay=0.97), rng(5)), 40)
    np.testing.assert_allclose(screened.mean, power.mean, rtol=1e-12)


def test_the_model_learns_from_every_rollout() -> None:
    model = CrudeModel()
    climb(ScreenedPower(SIZE, Settings(candidates=5), rng(0), model), 9)
    assert model.count == 9


def test_a_good_model_helps_and_a_wrong_one_leaves_the_measured_returns_to_decide() -> None:
    class Wrong(CrudeModel):
        def predict(self, z: np.ndarray) -> np.ndarray:
            return -super().predict(z)

    settings = Settings(candidates=50)
    right = climb(ScreenedPower(SIZE, settings, rng(1), CrudeModel()), 30)
    assert hill(right.mean) > 0.8
    wrong = ScreenedPower(SIZE, settings, rng(1), Wrong())
    executed = []
    for _ in range(30):
        executed.append(wrong.ask())
        wrong.tell(executed[-1], hill(executed[-1]))
    # The elite has three rollouts, and the model does not influence which.
    elite = sorted(executed, key=hill)[-3:]
    expected = np.average(elite, axis=0, weights=[hill(z) for z in elite])
    np.testing.assert_allclose(wrong.mean, expected)


def test_the_model_learns_the_newest_rollout_with_its_return() -> None:
    learnt: list[tuple[list[float], float]] = []

    class Recording(CrudeModel):
        def learn(self, z: np.ndarray, ret: float) -> None:
            learnt.append((z.tolist(), ret))

    learner = ScreenedPower(SIZE, Settings(candidates=5), rng(0), Recording())
    told = [(rng(k).standard_normal(SIZE), 0.1 * k) for k in range(4)]
    for z, ret in told:
        learner.tell(z, ret)
    assert learnt == [(z.tolist(), ret) for z, ret in told]
