# SPDX-License-Identifier: Apache-2.0
"""The ball is put back without a hand: the cup is emptied, a swing is stilled."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware_sim.scenes.ball_in_cup import HOME
from hardware_sim.wam import JOINTS
from wam_power_ros.control.arm import Arm
from wam_power_ros.params.resources import robot_description
from wam_power_ros.tasks.ball_in_cup.reset_body import (
    REQUEST_TIME,
    VELOCITY_LAG,
    damp_swing,
    empty_cup,
    swing_phasor,
    swing_rate,
)
from wam_power_ros.tasks.ball_in_cup.swing import STRING

ARM = Arm(robot_description("urdf/wam7_cup.urdf"), JOINTS, "cup", guarded=())
SWING_RATE = swing_rate(STRING)


def seen(amplitude: complex) -> tuple[float, float]:
    """Ball beside its rest, and the velocity that a tracker has of it, for a swing."""
    late = amplitude * np.exp(-1j * SWING_RATE * VELOCITY_LAG)
    return amplitude.real, (1j * SWING_RATE * late).real


@given(st.floats(0.0, 0.3), st.floats(-math.pi, math.pi))
def test_a_swing_is_known_from_one_state_although_its_velocity_is_late(
    size: float, phase: float
) -> None:
    amplitude = size * np.exp(1j * phase)
    beside, velocity = seen(amplitude)
    found = swing_phasor(np.array([beside, 0.0]), np.array([velocity, 0.0]), SWING_RATE)
    assert found[0] == pytest.approx(amplitude, abs=1e-9) and found[1] == 0.0


def left(move: tuple[np.ndarray, np.ndarray], swing: np.ndarray) -> np.ndarray:
    """Amplitudes of a small swing along x and y after a movement that begins after the request."""
    t = move[0] + REQUEST_TIME
    cup = np.array([ARM.tool_pose(q)[0] for q in move[1]])
    cup = scipy.interpolate.CubicSpline(t, cup[:, :2])
    end, dt, rest = t[-1], 0.001, cup(t[0])
    x, v = swing.real.copy(), -(SWING_RATE * swing.imag)
    for now in np.arange(0.0, end, dt):
        at = cup(now) if now > t[0] else rest
        v -= dt * SWING_RATE**2 * (x - (at - rest))
        x += dt * v
    return np.hypot(x, v / SWING_RATE)


@settings(max_examples=8)
@given(st.floats(0.0, 0.13), st.floats(-3.1, 3.1), st.floats(0.0, 0.05), st.floats(-3.1, 3.1))
def test_a_movement_stills_most_of_a_swing_whatever_its_phase_and_direction(
    x: float, phase_x: float, y: float, phase_y: float
) -> None:
    swing = np.array([x, y]) * np.exp(1j * np.array([phase_x, phase_y]))
    move = damp_swing(ARM, HOME, swing, SWING_RATE)
    assert left(move, swing).max() <= 0.25 * np.abs(swing).max() + 0.003


def test_movements_begin_and_end_at_the_start_at_rest_with_an_upright_cup_on_its_way() -> None:
    still = damp_swing(ARM, HOME, np.array([0.1 + 0.05j, -0.1j]), SWING_RATE)
    for move in (still, empty_cup(HOME)):
        np.testing.assert_allclose(move.q[[0, -1]], [HOME, HOME], atol=1e-9)
        assert (np.diff(move.t) > 0.0).all() and len(move.t) == len(move.q)
        speed = np.abs(np.diff(move.q, axis=0)).max(axis=0) / np.diff(move.t)[0]
        assert (speed < 0.8 * ARM.qd_max).all()
        assert ((ARM.q_min < move.q) & (move.q < ARM.q_max)).all()
    tilt = [ARM.tool_pose(q)[1][2, 2] for q in still.q]
    assert min(tilt) > math.cos(math.radians(3.0))


@pytest.mark.parametrize("roll", [-0.4, 0.4])  # more than the joint has beyond `ROLL`
def test_an_emptied_cup_has_been_upside_down(roll: float) -> None:
    start = HOME + roll * np.eye(7)[-1]
    move = empty_cup(start)
    assert min(ARM.tool_pose(q)[1][2, 2] for q in move.q) < -0.7
    assert ((ARM.q_min < move.q) & (move.q < ARM.q_max)).all()
