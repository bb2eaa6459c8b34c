# SPDX-License-Identifier: Apache-2.0
"""Vector error of a toss: measured, and predicted from the path of the pan."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from wam_power_ros import rotations
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import EndEffectorPath, Foreseen
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.flight import DELTA_H
from wam_power_ros.tasks.flip.task import Flip
from wam_power_ros.tasks.flip.toss_errors import (
    LANDING_TOLERANCE,
    SLACK,
    SPIN_DECAY,
    SPIN_DECAY_SD,
    TURN_TOLERANCE,
    measured_error,
    predict_toss,
)

G = 9.81
RISE = 0.2  # [s]
BRAKE = 60.0  # [m/s^2]
SETTINGS = preset("flip").task_settings


def path(z: np.ndarray, pitch: np.ndarray, x: np.ndarray | None = None) -> EndEffectorPath:
    """Path of a pan at 500 Hz; pitch with the front edge up [rad]."""
    x = np.zeros_like(z) if x is None else x
    quat_xyzw = np.column_stack(
        [np.zeros_like(z), -np.sin(0.5 * pitch), np.zeros_like(z), np.cos(0.5 * pitch)]
    )
    return EndEffectorPath(
        "pan", 0.002 * np.arange(len(z)), np.column_stack([x, 0.0 * z, z]), quat_xyzw
    )


def thrown(
    speed: float, tilt: float = 0.0, rate: float = 0.0, ahead: float = 0.0
) -> EndEffectorPath:
    """A pan that rises to `speed` [m/s] while it turns ever faster, and stops within centimetres.

    From the release on it turns at a constant rate [rad/s]; later it moves ahead [m].
    """
    t = 0.002 * np.arange(751)
    stop = RISE + speed / BRAKE
    up, down = np.minimum(t, RISE), np.clip(t - RISE, 0.0, speed / BRAKE)
    z = 0.5 * speed / RISE * up**2 + speed * down - 0.5 * BRAKE * down**2
    pitch = tilt + rate * (0.5 * up**2 / RISE + np.maximum(t - RISE, 0.0))
    x = ahead * np.clip((t - stop) / 0.1, 0.0, 1.0)
    return path(z, pitch, x)


def time_of_flight(speed: float) -> float:
    """From the release until it falls through Delta_h above the pan that has stopped [s]."""
    height = 0.5 * speed**2 / BRAKE + DELTA_H
    return (speed + math.sqrt(speed**2 - 2.0 * G * height)) / G


def test_a_pan_at_rest_or_lowered_gently_does_not_toss() -> None:
    still = np.zeros(500)
    assert predict_toss(path(still, still)) == (False, 0.0, (0.0, 0.0), 0.0)
    lowered = 0.1 * np.cos(np.linspace(0.0, math.pi, 500))
    assert not predict_toss(path(lowered, still)).tossed


@pytest.mark.parametrize("rate", [0.5, -0.5])
@pytest.mark.parametrize("speed", [2.0, 3.0])
def test_the_pancake_turns_with_the_pan_and_then_freely_slowed_by_drag(
    speed: float, rate: float
) -> None:
    # So slow that the point of the pan below the pancake moves straight up.
    free, slowed = (predict_toss(thrown(speed, rate=rate), spin_decay=k) for k in (1e-9, 4.0))
    flight, spin = time_of_flight(speed), rate
    assert free.tossed and slowed.tossed
    assert free.angle == pytest.approx(0.5 * rate * RISE + rate * flight, rel=0.05)
    turned, dt = 0.0, 1e-5
    for _ in range(round(flight / dt)):  # d spin / dt = -4 spin |spin|
        turned, spin = turned + dt * spin, spin - dt * 4.0 * spin * abs(spin)
    assert slowed.angle == pytest.approx(0.5 * rate * RISE + turned, rel=0.05)


@pytest.mark.parametrize("rate", [3.0, -3.0])
def test_the_derivative_by_the_decay_is_that_of_the_rotation(rate: float) -> None:
    pan = thrown(2.5, rate=rate)
    low, here, high = (predict_toss(pan, spin_decay=k) for k in (0.399, 0.4, 0.401))
    assert here.angle_by_decay == pytest.approx((high.angle - low.angle) / 0.002, rel=1e-3)
    assert here.angle_by_decay * rate < 0.0


def test_a_toss_that_does_not_reach_delta_h_is_none() -> None:
    needed = math.sqrt(2.0 * G * DELTA_H / (1.0 - G / BRAKE))
    assert not predict_toss(thrown(0.95 * needed)).tossed
    assert predict_toss(thrown(1.1 * needed)).tossed


def test_the_landing_error_is_where_the_pancake_comes_down_in_the_pan() -> None:
    here, ahead = (predict_toss(thrown(2.5, ahead=shift)) for shift in (0.0, 0.1))
    assert here.landing_error[0] - ahead.landing_error[0] == pytest.approx(0.1, abs=1e-6)
    pan = thrown(2.5)
    moved = pan.position + np.outer(pan.t > RISE + 0.1, [0.0, 0.07, 0.0])
    aside = predict_toss(dataclasses.replace(pan, position=moved)).landing_error
    assert np.subtract(aside, here.landing_error) == pytest.approx([0.0, -0.07], abs=1e-6)


def test_on_a_tilted_pan_the_pancake_lies_at_the_lower_rim() -> None:
    forward, back, level = (
        predict_toss(thrown(2.5, tilt=tilt)).landing_error[0] for tilt in (-0.25, 0.25, 0.0)
    )
    assert forward == pytest.approx(SLACK, rel=0.2) and back == pytest.approx(-SLACK, rel=0.2)
    assert abs(level) < 0.1 * SLACK


def test_a_dip_after_which_the_pancake_falls_back_is_not_the_toss() -> None:
    """The pan drops by 3 cm faster than it could fall, waits, and throws: only that counts."""
    t = 0.002 * np.arange(200)
    drop = 0.015 * (np.cos(math.pi * np.clip(t / 0.05, 0.0, 1.0)) - 1.0)
    throw = thrown(2.5, rate=2.0)
    z = np.concatenate([drop, throw.position[:, 2] - 0.03])
    turn = rotations.matrix(throw.quat_xyzw)[:, :, 2]
    pitch = np.concatenate([np.zeros(200), np.arctan2(-turn[:, 0], turn[:, 2])])
    alone, after = predict_toss(throw), predict_toss(path(z, pitch))
    assert after.tossed
    assert after.angle == pytest.approx(alone.angle, rel=0.02)


def test_a_measured_error_is_in_tolerances_and_has_no_landing_without_a_toss() -> None:
    flight = {
        "tossed": True,
        "seen": True,
        "angle": math.pi + TURN_TOLERANCE,
        "landing_error": [2.0 * LANDING_TOLERANCE, 0.5, 0.1],
    }
    np.testing.assert_allclose(measured_error(flight), [1.0, 2.0, 0.5 / LANDING_TOLERANCE])
    assert measured_error({**flight, "seen": False}) is None
    assert measured_error(None) is None
    turn, *landing = measured_error({**flight, "tossed": False, "angle": 0.0})
    assert turn == pytest.approx(-math.pi / TURN_TOLERANCE) and np.isnan(landing).all()


def test_the_model_of_the_task_predicts_the_toss_of_the_foreseen_path_and_its_excess(
    demonstrated: Policy,
) -> None:
    task = Flip(SETTINGS, {})
    parametrization = task.parametrization(demonstrated)
    pan, excess = thrown(2.5, rate=4.0), np.array([-0.3, 0.2])
    model = task.error_model(parametrization, lambda policy: Foreseen(pan, excess))
    prediction = model.predict(np.zeros(parametrization.size))
    toss = predict_toss(pan)
    landing = np.array(toss.landing_error) / LANDING_TOLERANCE
    wanted = [(toss.angle - math.pi) / TURN_TOLERANCE, *landing]
    np.testing.assert_allclose(prediction.error, wanted)
    np.testing.assert_array_equal(prediction.excess, excess)
    more = predict_toss(pan, spin_decay=SPIN_DECAY + 0.01 * SPIN_DECAY_SD).angle
    by_decay = (more - toss.angle) / (0.01 * TURN_TOLERANCE)
    assert prediction.uncertain.shape == (3, 1)
    np.testing.assert_allclose(prediction.uncertain[:, 0], [by_decay, 0.0, 0.0], rtol=0.02)
    none = task.error_model(parametrization, lambda policy: None)
    assert none.predict(np.zeros(parametrization.size)) is None


def test_the_directions_are_those_of_the_corrections(demonstrated: Policy) -> None:
    """A step along a direction of the model changes only the parameter of a correction."""
    task = Flip(SETTINGS, {})
    parametrization = task.parametrization(demonstrated)
    model = task.error_model(parametrization, lambda policy: None)
    names = ("vigour", "tempo", "flick", "catch_shift", "side_shift")
    moved = [int(np.flatnonzero(row)[0]) for row in model.directions]
    assert moved == [parametrization.groups[name].start for name in names]
    assert (np.count_nonzero(model.directions, axis=1) == 1).all()
    assert (model.slopes[0, :3] > 0.0).all() and model.slopes[1, 3] < 0.0
    assert model.slopes[2, 4] < 0.0 == model.slopes[2, 3] == model.slopes[1, 4]


def test_other_parameters_than_the_planar_ones_have_no_error_model(demonstrated: Policy) -> None:
    task = Flip(preset("flip", "paper").task_settings, {})
    assert task.error_model(task.parametrization(demonstrated), lambda policy: None) is None


@pytest.fixture
def demonstrated() -> Policy:
    """A policy of eight spring-dampers."""
    from toss_task import demonstrated_policy

    return demonstrated_policy()
