# SPDX-License-Identifier: Apache-2.0
"""Vector error of a toss: measured, and predicted from the path of the pan."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from pan_paths import path, thrown
from toss_task import demonstrated_policy

from wam_power_ros.learning.rollout import Foreseen
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.errors import told
from wam_power_ros.tasks.flip.pan_toss import predict_toss
from wam_power_ros.tasks.flip.task import Flip
from wam_power_ros.tasks.flip.toss_errors import ERRORS, SLOWED

TURN_TOLERANCE, LANDING_TOLERANCE, _, LEVEL_TOLERANCE = (error.tolerance for error in ERRORS[:4])
SETTINGS = preset("flip").task_settings


def test_a_measured_error_is_in_tolerances_and_has_no_landing_without_a_toss() -> None:
    flight = {
        "tossed": True,
        "seen": True,
        "angle": math.pi + TURN_TOLERANCE,
        "landing_error": [2.0 * LANDING_TOLERANCE, 0.5, 0.1],
        "catch_pitch": -3.0 * LEVEL_TOLERANCE,
    }
    wanted = [1.0, 2.0, 0.5 / LANDING_TOLERANCE, -3.0]
    task = Flip(SETTINGS, {})
    np.testing.assert_allclose(task.error(flight), wanted)
    assert task.error({**flight, "seen": False}) is None
    assert task.error(None) is None
    turn, *catch = task.error({**flight, "tossed": False, "angle": 0.0})
    assert turn == pytest.approx(-math.pi / TURN_TOLERANCE) and np.isnan(catch).all()


@pytest.mark.parametrize(("miss", "climb"), [(0.05, 0.01), (0.09, 0.01), (0.05, 0.03)])
def test_a_flip_is_inside_its_limits_as_far_as_turn_miss_and_climb_are(
    miss: float, climb: float
) -> None:
    flight = {"tossed": True, "seen": True, "angle": math.radians(170.0), "climb": climb}
    flight |= {"landing_error": [0.6 * miss, -0.8 * miss, 0.2], "catch_pitch": 0.3}
    record = SimpleNamespace(observation=flight)
    inside = [math.radians(20.0), 0.08 - miss, 0.025 - climb]
    assert Flip(SETTINGS, {}).margins(record) == pytest.approx(inside)
    assert list(Flip(preset("flip", "paper").task_settings, {}).margins(record)) == []
    for unknown in (None, {name: it for name, it in flight.items() if name != "climb"}):
        assert list(Flip(SETTINGS, {}).margins(SimpleNamespace(observation=unknown))) == []


def test_the_model_of_the_task_predicts_the_toss_of_the_foreseen_path_and_its_excess() -> None:
    task = Flip(SETTINGS, {})
    parametrization = task.parametrization(demonstrated_policy())
    pan, excess = thrown(2.5, rate=4.0), np.array([-0.3, 0.2])
    model = task.error_model(parametrization, lambda policy: Foreseen(pan, excess))
    prediction = model.predict(np.zeros(parametrization.size))
    np.testing.assert_allclose(prediction.error, told(task.learnt_errors(), predict_toss(pan)))
    assert np.isfinite(prediction.error).all()
    np.testing.assert_array_equal(prediction.excess, excess)
    assert prediction.uncertain.shape == (4, 1)
    slowed = told(task.learnt_errors(), predict_toss(pan, pancake=SLOWED))
    assert slowed[0] < prediction.error[0]
    np.testing.assert_allclose(prediction.uncertain[:, 0], slowed - prediction.error)
    none = task.error_model(parametrization, lambda policy: None)
    assert none.predict(np.zeros(parametrization.size)) is None


def test_a_pan_that_does_not_toss_lacks_the_turn_and_its_landing_is_unknown() -> None:
    task = Flip(SETTINGS, {})
    parametrization = task.parametrization(demonstrated_policy())
    still = Foreseen(path(np.zeros(500), np.zeros(500)), np.array([-0.3]))
    model = task.error_model(parametrization, lambda policy: still)
    turn, *landing = model.predict(np.zeros(parametrization.size)).error
    assert turn == pytest.approx(-math.pi / TURN_TOLERANCE) and np.isnan(landing).all()


def test_the_directions_are_those_of_the_corrections() -> None:
    """A step along a direction of the model changes only the parameter of a correction."""
    task = Flip(SETTINGS, {})
    parametrization = task.parametrization(demonstrated_policy())
    model = task.error_model(parametrization, lambda policy: None)
    names = ("vigour", "tempo", "flick", "catch_shift", "side_shift", "catch_pitch")
    moved = [int(np.flatnonzero(row)[0]) for row in model.directions]
    assert moved == [parametrization.groups[name].start for name in names]
    assert (np.count_nonzero(model.directions, axis=1) == 1).all()
    assert (model.slopes[0, :3] > 0.0).all() and model.slopes[1, 3] < 0.0
    assert model.slopes[2, 4] < 0.0 == model.slopes[2, 3] == model.slopes[1, 4]
    assert model.slopes[3, 5] < 0.0 and np.count_nonzero(model.slopes) == 6
