# SPDX-License-Identifier: Apache-2.0
"""What rollouts say about a model whose numbers are assumed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hill_task import rng

from wam_power_ros.learning.discrepancy import Discrepancy
from wam_power_ros.learning.learner import Prediction

SIZE = 4
OFF = 2.5  # standard deviations that the number of the model is off


def assumed(z: np.ndarray) -> np.ndarray:
    """Change of both errors by a standard deviation of the number. Shape (2, 1)."""
    return np.array([[1.0 + z[0]], [0.0]])


def predicted(z: np.ndarray, told: bool = True) -> Prediction:
    error = np.array([z[1] - 3.0, z[2]])
    return Prediction(error, np.array([-1.0]), *([assumed(z)] if told else []))


def true(z: np.ndarray) -> np.ndarray:
    return predicted(z).error + OFF * assumed(z)[:, 0]


def after(count: int, told: bool = True) -> Discrepancy:
    z = rng(5).normal(size=(count, SIZE))
    errors = np.array([true(each) for each in z]).reshape(-1, 2)
    said = [predicted(each, told) for each in z]
    return Discrepancy(z, errors, said, np.zeros_like(errors), 10.0)


FAR = np.array([8.0, 0.0, 0.0, 0.0])


def expected(count: int, told: bool = True) -> tuple[np.ndarray, np.ndarray]:
    return after(count, told).expected(FAR, predicted(FAR, told), np.zeros(2))


def test_a_number_that_a_model_only_assumes_is_learnt_and_holds_far_from_the_rollouts() -> None:
    mean, _ = expected(6)
    assert mean == pytest.approx(true(FAR), abs=1.5)
    untold, _ = expected(6, told=False)
    assert abs(untold[0] - true(FAR)[0]) > 5.0


def test_before_rollouts_its_spread_is_that_of_the_number_and_then_it_falls() -> None:
    _, before = expected(0)
    _, without = expected(0, told=False)
    assert before[0] - without[0] == pytest.approx(0.5 * assumed(FAR)[0, 0] ** 2)  # at weight 0.5
    assert before[1] == pytest.approx(without[1])
    assert expected(6)[1][0] < 0.2 * before[0]


def test_a_model_with_a_wrong_number_keeps_its_weight() -> None:
    assert after(6).weight > 0.99 > after(6, told=False).weight


def test_rollouts_without_a_prediction_leave_the_others_what_they_say() -> None:
    z = rng(5).normal(size=(7, SIZE))
    errors = np.array([true(each) for each in z])
    said = [*(predicted(each) for each in z[:6]), None]
    found = Discrepancy(z, errors, said, np.zeros_like(errors), 10.0)
    mean, _ = found.expected(FAR, predicted(FAR), np.zeros(2))
    known = Discrepancy(z[:6], errors[:6], said[:6], np.zeros((6, 2)), 10.0)
    assert mean[0] == pytest.approx(known.expected(FAR, predicted(FAR), np.zeros(2))[0][0], abs=1.0)
    blind = Discrepancy(z[6:], errors[6:], [None], np.zeros((1, 2)), 10.0)
    mean, spread = blind.expected(FAR, predicted(FAR), np.zeros(2))
    assert np.isfinite(mean).all() and spread[0] > assumed(FAR)[0, 0] ** 2 / 4.0


def test_one_toss_that_was_not_foreseen_is_outweighed_by_rollouts_foreseen_rightly() -> None:
    z = rng(5).normal(size=(4, SIZE))
    errors = np.array([predicted(each).error for each in z])
    said = [predicted(each) for each in z]
    missed = [said[0]._replace(error=np.full(2, math.nan)), *said[1:]]
    all_foreseen, one_missed = (
        Discrepancy(z, errors, each, np.zeros_like(errors), 10.0).weight for each in (said, missed)
    )
    assert 0.1 < one_missed < all_foreseen


def test_without_a_model_the_rough_description_is_expected() -> None:
    mean, spread = after(0).expected(FAR, None, np.array([1.0, math.pi]))
    assert mean.tolist() == [1.0, math.pi] and (spread > 0.0).all()
