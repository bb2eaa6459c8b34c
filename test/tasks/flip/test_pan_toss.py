# SPDX-License-Identifier: Apache-2.0
"""The toss that the path of a pan predicts, and the errors and the model of the task from it."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from toss_task import demonstrated_policy

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import EndEffectorPath, SimulatedRollout
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.errors import told
from wam_power_ros.tasks.flip.ballistic_fit import GRAVITY
from wam_power_ros.tasks.flip.frames import DELTA_H, PAN_RADIUS, PANCAKE_RADIUS
from wam_power_ros.tasks.flip.pan_toss import Pancake, predict_toss
from wam_power_ros.tasks.flip.task import Flip
from wam_power_ros.tasks.flip.toss_errors import ERRORS, PANCAKES

RISE = 0.2  # [s]
BRAKE = 60.0  # [m/s^2]
SLACK = PAN_RADIUS - PANCAKE_RADIUS  # from the middle of the pan to the rim [m]
AIRLESS = Pancake(spin_decay=0.0, drag=0.0)


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
    return (speed + math.sqrt(speed**2 - 2.0 * GRAVITY * height)) / GRAVITY


def landing(pan: EndEffectorPath) -> list[float]:
    """Landing error along x and y [m]."""
    toss = predict_toss(pan)
    return [toss["landing_x"], toss["landing_y"]]


def test_on_a_pan_at_rest_or_lowered_gently_nothing_turns_or_lands_elsewhere() -> None:
    still = np.zeros(500)
    for z in (still, 0.1 * np.cos(np.linspace(0.0, math.pi, 500))):
        stays = predict_toss(path(z, still))
        assert stays.pop("rotation") == pytest.approx(-math.pi, abs=1e-3)
        assert list(stays.values()) == pytest.approx([0.0] * 4, abs=1e-3)


@pytest.mark.parametrize(("speed", "rate"), [(2.0, 0.5), (3.0, -0.5)])
def test_the_pancake_turns_with_the_pan_and_then_freely_slowed_by_drag(
    speed: float, rate: float
) -> None:
    free, slowed = (
        predict_toss(thrown(speed, rate=rate), pancake=AIRLESS._replace(spin_decay=k))
        for k in (0.0, 4.0)
    )
    flight, spin = time_of_flight(speed), rate
    assert free["rotation"] + math.pi == pytest.approx(0.5 * rate * RISE + rate * flight, rel=0.05)
    turned, dt = 0.0, 1e-5
    for _ in range(round(flight / dt)):  # d spin / dt = -4 spin |spin|
        turned, spin = turned + dt * spin, spin - dt * 4.0 * spin * abs(spin)
    assert slowed["rotation"] + math.pi == pytest.approx(0.5 * rate * RISE + turned, rel=0.05)


def test_the_errors_of_a_toss_change_little_where_it_just_reaches_delta_h() -> None:
    needed = math.sqrt(2.0 * GRAVITY * DELTA_H / (1.0 - GRAVITY / BRAKE))
    weak, low, high, strong = (
        predict_toss(thrown(share * needed, rate=4.0), pancake=AIRLESS)
        for share in (0.9, 0.99, 1.01, 1.1)
    )
    assert weak["rotation"] < low["rotation"] < high["rotation"] < strong["rotation"]
    for name, value in low.items():
        assert high[name] == pytest.approx(value, abs=0.2)
    dragged = predict_toss(thrown(1.1 * needed, rate=4.0), pancake=AIRLESS._replace(drag=3.0))
    assert dragged["apex"] < strong["apex"] - 0.01


def test_of_a_low_toss_counts_the_share_of_its_rotation_that_it_rose_of_delta_h() -> None:
    speed, rate = 0.7 * math.sqrt(2.0 * GRAVITY * DELTA_H / (1.0 - GRAVITY / BRAKE)), 0.5
    turned = 0.5 * rate * RISE + rate * speed / GRAVITY
    low = predict_toss(thrown(speed, rate=rate), pancake=AIRLESS)
    assert low["rotation"] + math.pi == pytest.approx(0.7**2 * turned, rel=0.1)


def test_the_landing_error_is_where_the_pancake_comes_down_in_the_pan() -> None:
    here, ahead = (predict_toss(thrown(2.5, ahead=shift)) for shift in (0.0, 0.1))
    assert here["landing_x"] - ahead["landing_x"] == pytest.approx(0.1, abs=1e-6)
    pan = thrown(2.5)
    moved = pan.position + np.outer(pan.t > RISE + 0.1, [0.0, 0.07, 0.0])
    aside = landing(dataclasses.replace(pan, position=moved))
    assert np.subtract(aside, landing(pan)) == pytest.approx([0.0, -0.07], abs=1e-6)
    carried = pan.position + np.outer(pan.t > 0.1, [0.0, 0.07, 0.0])  # before the release
    with_it = landing(dataclasses.replace(pan, position=carried))
    assert with_it == pytest.approx(landing(pan), abs=1e-6)


def test_a_dip_after_which_the_pancake_falls_back_is_not_the_toss() -> None:
    """The pan drops by 3 cm faster than it could fall, waits, and throws: only that counts."""
    t = 0.002 * np.arange(200)
    drop = 0.015 * (np.cos(math.pi * np.clip(t / 0.05, 0.0, 1.0)) - 1.0)
    throw = thrown(2.5, rate=2.0)
    z = np.concatenate([drop, throw.position[:, 2] - 0.03])
    turn = rotations.matrix(throw.quat_xyzw)[:, :, 2]
    pitch = np.concatenate([np.zeros(200), np.arctan2(-turn[:, 0], turn[:, 2])])
    alone, after = predict_toss(throw), predict_toss(path(z, pitch))
    assert after["rotation"] + math.pi == pytest.approx(alone["rotation"] + math.pi, rel=0.02)


def test_a_rim_that_is_drawn_back_brakes_the_spin_of_the_pancake_at_it() -> None:
    """As after a flick: the front of the rim holds the front edge, which then lags."""
    throw = thrown(2.5, tilt=-0.25, rate=4.0)
    drawn = throw.position.copy()
    drawn[:, 0] -= 6.0 * np.clip(throw.t - RISE, 0.0, 0.1) ** 2
    free, braked = (
        predict_toss(each, pancake=AIRLESS)
        for each in (throw, dataclasses.replace(throw, position=drawn))
    )
    assert braked["rotation"] + math.pi < 0.9 * (free["rotation"] + math.pi)


TURN_TOLERANCE, LANDING_TOLERANCE, _, LEVEL_TOLERANCE = (error.tolerance for error in ERRORS[:4])

SETTINGS = preset("flip").task_settings


def test_a_measured_error_is_in_tolerances_whether_it_was_tossed_or_not() -> None:
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
    np.testing.assert_allclose(task.error({**flight, "tossed": False}), wanted)


@pytest.mark.parametrize(("miss", "climb"), [(0.05, 0.01), (0.09, 0.01), (0.05, 0.05)])
def test_a_flip_is_inside_its_limits_as_far_as_turn_miss_and_climb_are(
    miss: float, climb: float
) -> None:
    flight = {"tossed": True, "seen": True, "angle": math.radians(170.0), "climb": climb}
    flight |= {"landing_error": [0.6 * miss, -0.8 * miss, 0.2], "catch_pitch": 0.3}
    record = SimpleNamespace(observation=flight)
    inside = [math.radians(20.0), 0.08 - miss, 0.045 - climb]
    assert Flip(SETTINGS, {}).success_margins(record) == pytest.approx(inside)
    assert list(Flip(preset("flip", "paper").task_settings, {}).success_margins(record)) == []
    for unknown in (None, {name: it for name, it in flight.items() if name != "climb"}):
        assert list(Flip(SETTINGS, {}).success_margins(SimpleNamespace(observation=unknown))) == []


def test_the_model_of_the_task_predicts_the_toss_of_the_foreseen_path_and_its_excess() -> None:
    task = Flip(SETTINGS, {})
    parametrization = task.parametrization(demonstrated_policy())
    pan, limit_excess = thrown(2.5, rate=4.0), np.array([-0.3, 0.2])
    model = task.error_model(parametrization, lambda policy: SimulatedRollout(pan, limit_excess))
    prediction = model.predict(np.zeros(parametrization.size))
    np.testing.assert_allclose(prediction.error, told(task.learnt_errors(), predict_toss(pan)))
    assert np.isfinite(prediction.error).all()
    np.testing.assert_array_equal(prediction.limit_excess, limit_excess)
    assert prediction.uncertain.shape == (4, 3)
    for pancake, uncertain in zip(PANCAKES[1:], prediction.uncertain.T, strict=True):
        other = told(task.learnt_errors(), predict_toss(pan, pancake=pancake))
        np.testing.assert_allclose(uncertain, other - prediction.error)
    assert prediction.uncertain[0, 0] < 0.0, "drag slows the spin"
    none = task.error_model(parametrization, lambda policy: None)
    assert none.predict(np.zeros(parametrization.size)) is None
