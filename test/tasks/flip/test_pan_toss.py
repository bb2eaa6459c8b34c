# SPDX-License-Identifier: Apache-2.0
"""Toss of a pancake by a pan that moves along a path."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from pan_paths import BRAKE, RISE, path, thrown

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.tasks.flip.ballistic_fit import GRAVITY
from wam_power_ros.tasks.flip.flight import DELTA_H
from wam_power_ros.tasks.flip.frames import PAN_RADIUS, PANCAKE_RADIUS
from wam_power_ros.tasks.flip.pan_toss import Pancake, predict_toss

SLACK = PAN_RADIUS - PANCAKE_RADIUS  # from the middle of the pan to the rim [m]
AIRLESS = Pancake(spin_decay=0.0, drag=0.0)


def time_of_flight(speed: float) -> float:
    """From the release until it falls through Delta_h above the pan that has stopped [s]."""
    height = 0.5 * speed**2 / BRAKE + DELTA_H
    return (speed + math.sqrt(speed**2 - 2.0 * GRAVITY * height)) / GRAVITY


def landing(pan: EndEffectorPath) -> list[float]:
    """Landing error along x and y [m]."""
    toss = predict_toss(pan)
    return [toss["landing_x"], toss["landing_y"]]


def test_a_pan_at_rest_or_lowered_gently_does_not_toss() -> None:
    still = np.zeros(500)
    assert predict_toss(path(still, still)) is None
    lowered = 0.1 * np.cos(np.linspace(0.0, math.pi, 500))
    assert predict_toss(path(lowered, still)) is None


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


def test_a_toss_that_does_not_reach_delta_h_is_none_and_drag_needs_more() -> None:
    needed = math.sqrt(2.0 * GRAVITY * DELTA_H / (1.0 - GRAVITY / BRAKE))
    assert predict_toss(thrown(0.95 * needed), pancake=AIRLESS) is None
    assert predict_toss(thrown(1.1 * needed), pancake=AIRLESS) is not None
    assert predict_toss(thrown(1.1 * needed), pancake=AIRLESS._replace(drag=3.0)) is None


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


def test_the_catch_pitch_is_that_of_the_pan_at_the_landing() -> None:
    pan = thrown(2.5, rate=0.3)
    pitch = predict_toss(pan, pancake=AIRLESS)["catch_pitch"]
    assert pitch == pytest.approx(0.3 * (0.5 * RISE + time_of_flight(2.5)), rel=0.05)


def test_on_a_tilted_pan_the_pancake_lies_at_the_lower_rim() -> None:
    forward, back, level = (
        predict_toss(thrown(2.5, tilt=tilt), pancake=AIRLESS)["landing_x"]
        for tilt in (-0.25, 0.25, 0.0)
    )
    assert forward == pytest.approx(SLACK, rel=0.2) and back == pytest.approx(-SLACK, rel=0.2)
    assert abs(level) < 0.1 * SLACK


@pytest.mark.parametrize(("friction", "left"), [(0.0, -0.03), (0.8, 0.0)])
def test_friction_takes_the_pancake_along_with_a_pan_that_moves(
    friction: float, left: float
) -> None:
    pancake = AIRLESS._replace(friction=friction)
    landing = predict_toss(_moved_and_thrown(0.03), pancake=pancake)["landing_x"]
    assert landing == pytest.approx(left, abs=0.003)


@pytest.mark.parametrize("shift", [0.2, -0.2])
def test_the_rim_takes_along_what_friction_does_not(shift: float) -> None:
    toss = predict_toss(_moved_and_thrown(shift), pancake=AIRLESS._replace(friction=0.0))
    assert abs(toss["landing_x"]) < 0.1


def _moved_and_thrown(shift: float) -> EndEffectorPath:
    """A pan that moves along x [m] within a second, stops, and throws."""
    throw = thrown(2.5)
    aside = shift * 0.5 * (1.0 - np.cos(math.pi * np.linspace(0.0, 1.0, 501)))
    z = np.concatenate([np.zeros(501), throw.position[:, 2]])
    return path(z, np.zeros_like(z), np.concatenate([aside, np.full(len(throw.t), shift)]))


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
