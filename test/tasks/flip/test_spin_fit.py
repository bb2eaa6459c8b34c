# SPDX-License-Identifier: Apache-2.0
"""Spin fit, against exact spins and against a simulated toss."""

import math

import numpy as np
import pytest
from simulated_toss import Toss, capture, toss

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath
from wam_power_ros.tasks.flip.ballistic_fit import fit_arc
from wam_power_ros.tasks.flip.frames import frames_from_pan
from wam_power_ros.tasks.flip.spin_fit import (
    Spin,
    _spin_guesses,
    _SpinProblem,
    angle_between,
    fit_spin,
)

UP = np.array([0.0, 0.0, 1.0])
OMEGA = np.array([0.3, -7.0, 1.0])  # [rad/s]


def spin(omega: np.ndarray = OMEGA, decay: float = 0.0, **changes: object) -> Spin:
    values = {
        "origin": 0.5,
        "release": 0.2,
        "normal0": UP,
        "theta": np.array([0.0, 0.0, *omega, decay]),
    }
    return Spin(**{**values, **changes})


def fitted(truth: Toss, path: BodyPath) -> Spin:
    frames = frames_from_pan(truth.pan, path)
    arc = fit_arc(frames)
    assert arc is not None
    return fit_spin(frames, arc, truth.pan)


def test_a_spin_is_not_extrapolated_to_infinity_where_the_decay_has_its_pole() -> None:
    steep = spin(np.array([0.0, 6.0, 0.0]), 4.0)  # 1 + d s = 0 at 0.25 s
    assert np.isfinite(steep.normal(np.linspace(0.0, 0.5, 20))).all()


@pytest.mark.parametrize("turned", [0.3, 3.1, 3.5, 6.2, 11.0])
def test_the_angle_turned_is_unfolded_by_half_turns_about_the_spin_axis(turned: float) -> None:
    # Rests along z until 0.2 s, then turns about -y.
    rate = turned / 0.7
    start = rotations.exp([0.0, -0.3 * rate, 0.0]) @ UP  # at the origin, 0.3 s after the release
    across = spin(np.array([0.0, -rate, 0.0]), normal0=start)
    assert across.turned(UP, 0.9) == pytest.approx(turned)
    tilted = spin(np.zeros(3), normal0=np.array([math.sin(turned), 0.0, math.cos(turned)]))
    assert math.cos(tilted.turned(UP, 0.9)) == pytest.approx(math.cos(turned))


def test_the_jacobian_is_the_derivative_of_the_residuals() -> None:
    s = np.linspace(-0.2, 0.2, 6)
    targets = rotations.exp(np.outer(s, OMEGA)) @ UP
    problem = _SpinProblem(s, targets, np.full((6, 1), 0.01), UP)
    theta = np.array([0.1, -0.2, *OMEGA, 0.6])
    step = 1e-5
    columns = [
        (problem.residuals(theta + step * row) - problem.residuals(theta - step * row)) / (2 * step)
        for row in np.eye(6)
    ]
    assert problem.jacobian(theta) == pytest.approx(np.array(columns).T, abs=1e-3)


def test_the_residuals_of_the_true_spin_are_those_of_the_priors_alone() -> None:
    s = np.linspace(-0.2, 0.2, 6)
    targets = rotations.exp(np.outer(s, OMEGA)) @ UP
    problem = _SpinProblem(s, targets, np.full((6, 1), 0.01), UP)
    residuals = problem.residuals(np.array([0.0, 0.0, *OMEGA, 0.0]))
    assert residuals[:-5] == pytest.approx(0.0, abs=1e-9)
    assert residuals[-5:] == pytest.approx([*(OMEGA / 12.0), -1.0, OMEGA[2] / 3.0])


def test_frequent_frames_show_one_spin_and_rare_ones_may_hide_a_turn_more_or_less() -> None:
    for gap, whole_turns in ((0.05, [0.0]), (0.1, [0.0, -1.0, 1.0])):
        t = np.arange(6) * gap
        vectors = np.outer(t, [0.0, 4.0, 0.0])
        guesses = _spin_guesses(t, rotations.exp(vectors) @ UP)
        expected = [4.0 + turns * 2.0 * math.pi / gap for turns in whole_turns]
        np.testing.assert_allclose([guess[1] for guess in guesses], expected, rtol=1e-9)


def test_one_normal_far_off_changes_the_spin_little() -> None:
    rng = np.random.default_rng(24)
    truth = toss(rng, vz=2.4, half_turns=1.2)
    path = capture(truth, rng)
    k = int(np.argmin(np.abs(path.t - 0.5 * (truth.release + truth.t_f))))
    quat = path.quat_xyzw.copy()
    quat[k] = rotations.multiply(rotations.quat_of_vector([0.5, 0.0, 0.3]), quat[k])
    spoilt = fitted(truth, BodyPath(path.id, path.t, path.position, quat))
    expected = fitted(truth, path).normal(truth.t_f)[0]
    assert angle_between(spoilt.normal(truth.t_f)[0], expected) < 0.02


@pytest.mark.parametrize("angle", [0.0, 1e-9, math.pi - 1e-9])
def test_angles_are_accurate_near_zero_and_near_half_a_turn(angle: float) -> None:
    turned = np.array([math.sin(angle), 0.0, math.cos(angle)])
    assert angle_between(UP, turned) == pytest.approx(angle, abs=1e-15)
