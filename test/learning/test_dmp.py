# SPDX-License-Identifier: Apache-2.0
"""Eq. 1: tables, reproduction and fit."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy
from open_loop import reproduced

from wam_power_ros import rotations
from wam_power_ros.learning import dmp
from wam_power_ros.learning.demonstration import Demonstration, from_positions, rotation_from
from wam_power_ros.learning.dmp import (
    REFINED_MAX,
    FitSettings,
    activations,
    fit,
    path_error,
    positive_definite,
    reproduce_many,
    tabulate,
)
from wam_power_ros.learning.policy import Basis
from wam_power_ros.tasks.flip.settings import FLIP_FIT
from wam_power_ros.tasks.reach.settings import REACH_FIT

DT = 0.002


def toss(n: int = 426, seed: int | None = None) -> Demonstration:
    """A dip, a lift and a swing of the pan, of the size of a toss."""
    t = np.arange(n) * DT
    u = t / t[-1]
    position = np.stack(
        [0.7 + 0.1 * u**2, 0.02 * np.sin(2.0 * u), 0.9 - 0.12 * np.sin(2 * math.pi * u) * u], axis=1
    )
    if seed is not None:
        shape = np.random.default_rng(seed).normal(0.0, 0.01, 3)
        position = position + np.sin(math.pi * u)[:, None] * shape
    vectors = np.outer(0.4 * np.sin(2.0 * math.pi * u) * u, [0.1, -1.0, 0.0])
    quat = rotations.multiply(
        rotations.quat_of_vector(vectors),
        np.broadcast_to([0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)], (n, 4)),
    )
    flat = from_positions(position, DT)
    q = np.tile(np.linspace(0.1, 0.7, 7), (n, 1))
    return replace(flat, q=q, quat_xyzw=quat)


def reach(seed: int) -> Demonstration:
    """A reaching movement of half a metre on an arc, with minimum jerk."""
    rng = np.random.default_rng(seed)
    u = np.linspace(0.0, 1.0, rng.integers(180, 221))
    s = 10 * u**3 - 15 * u**4 + 6 * u**5
    arc = 0.06 * np.sin(math.pi * s)[:, None] * np.array([0.0, 0.3, 1.0]) * rng.uniform(0.8, 1.2)
    return from_positions(s[:, None] * np.array([0.5, 0.1, 0.0]) + arc, 0.01)


def rmse(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))))


def test_activations_are_the_normalised_gaussians_of_the_paper() -> None:
    basis = Basis(3, 1.0, 0.02)
    raw = np.exp(-((0.3 - np.array([0.0, 0.5, 1.0])) ** 2) / 0.04)
    assert activations(basis, np.array([0.3]))[0] == pytest.approx(raw / raw.sum())
    for variance in (1e-8, 0.003, 100.0):  # however narrow it is
        h = activations(Basis(8, 0.85, variance), np.linspace(-0.1, 2.0, 500))
        assert h.min() >= 0.0 and h.sum(axis=1) == pytest.approx(np.ones(500))
        assert np.array_equal(h[0], h[23]) and np.array_equal(h[230], h[-1])


def test_tabulated_acceleration_is_equation_1() -> None:
    policy = fit([toss()], FLIP_FIT, "p")
    tables = tabulate(policy)
    rng = np.random.default_rng(0)
    for k in (0, 17, len(tables.b) + 50):
        x, xd = rng.normal(size=(2, 3))
        h = activations(policy.basis, np.array([k * DT]))[0]
        expected = sum(
            h[i] * (policy.stiffness[i] @ (policy.attractors[i] - x) - policy.damping * xd)
            for i in range(8)
        )
        both = dmp.acceleration(tables, k, x, x, np.tile(xd, 2))
        assert both[:3] == pytest.approx(expected, rel=1e-9, abs=1e-9)
        turn = sum(
            h[i] * (400.0 * (policy.rotation_attractors[i] - x) - 36.0 * xd) for i in range(8)
        )
        assert both[3:] == pytest.approx(turn, rel=1e-9, abs=1e-9)


def test_a_reproduction_from_rest_stays_where_the_demonstration_ended() -> None:
    demonstration = reach(0)
    policy = fit([demonstration], replace(REACH_FIT, count=6), "p")
    start, end = demonstration.position[[0, -1]]
    springs, steps = (policy.stiffness[None], policy.attractors[None]), round(3.0 / DT)
    x, xd = reproduce_many(policy.basis, *springs, policy.damping, start, np.zeros(3), steps, DT)
    assert x[0, -1] == pytest.approx(end, abs=0.003)
    assert np.linalg.norm(xd[0, -1]) < 0.001


def test_the_toss_is_reproduced_to_millimetres_and_a_degree() -> None:
    demonstration = toss()
    policy = fit([demonstration], FLIP_FIT, "p")
    tables = tabulate(policy)
    x, _ = reproduced(policy, demonstration.position[0], demonstration.velocity[0])
    assert rmse(x, demonstration.position) < 0.005
    vectors = rotation_from(demonstration.quat_xyzw, demonstration.quat_xyzw[0])
    r, omega, path = vectors[0], np.zeros(3), []
    for k in range(len(tables.b)):
        path.append(r)
        omega = omega + DT * dmp.acceleration(tables, k, np.zeros(3), r, [0, 0, 0, *omega])[3:]
        r = r + DT * omega
    assert rmse(np.array(path), vectors) < math.radians(1.5)


def test_a_reach_ends_turned_as_demonstrated() -> None:
    flat = reach(0)
    u = np.clip((flat.t / flat.duration - 0.4) / 0.6, 0.0, 1.0)
    turn = np.outer(10 * u**3 - 15 * u**4 + 6 * u**5, [math.pi / 3, 0.0, 0.0])
    policy = fit([replace(flat, quat_xyzw=rotations.quat_of_vector(turn))], REACH_FIT, "p")
    springs = np.tile(policy.rotation_stiffness * np.eye(3), (1, 2, 1, 1))
    attractors, steps = policy.rotation_attractors[None], round(policy.basis.duration / DT) + 1
    r, _ = reproduce_many(
        policy.basis, springs, attractors, policy.rotation_damping, turn[0], turn[0], steps, DT
    )
    assert np.linalg.norm(r[0, -1] - turn[-1]) < math.radians(0.5)


def test_the_stiffness_is_the_rescaled_inverse_of_the_residuals_covariance() -> None:
    demonstration = toss()
    policy = fit([demonstration], FLIP_FIT, "p")
    h = activations(policy.basis, demonstration.t)
    d = demonstration
    y = d.acceleration / 325.0 + d.velocity * 32.0 / 325.0 + d.position
    plain = np.linalg.pinv(h) @ y  # attractors of the mean stiffness
    inverses = []
    for i in range(8):
        covariance = np.cov((h[:, i : i + 1] * (y - plain[i])).T)
        covariance += 1e-3 * np.trace(covariance) / 3.0 * np.eye(3)
        inverses.append(-scipy.linalg.logm(covariance))
    values = np.linalg.eigvalsh(inverses)
    share = (np.array(inverses) - values.min() * np.eye(3)) / (values.max() - values.min())
    expected = 150.0 * scipy.linalg.expm(math.log(500.0 / 150.0) * share)
    assert policy.stiffness == pytest.approx(expected, abs=0.02)


def along(demonstration: Demonstration, *axes: np.ndarray) -> Demonstration:
    """Project a movement on these orthonormal axes and add sensor noise."""
    part = np.transpose(axes) @ axes
    noise = np.random.default_rng(0).normal(0.0, 1e-4, demonstration.position.shape)
    start = demonstration.position[0]
    return replace(
        demonstration,
        position=start + (demonstration.position - start) @ part + noise,
        velocity=demonstration.velocity @ part,
        acceleration=demonstration.acceleration @ part,
    )


TILTED = rotations.exp([0.3, -0.5, 0.2])


@pytest.mark.parametrize("still", [1, 2], ids=["in a plane", "along a line"])
def test_an_axis_that_does_not_move_has_the_mean_stiffness_and_leaves_the_range_to_the_others(
    still: int,
) -> None:
    axes = TILTED.T if still == 1 else np.eye(3)
    policy = fit([along(toss(), *axes[still:])], FLIP_FIT, "p")
    for axis in axes[:still]:
        expected = np.tile(math.sqrt(150.0 * 500.0) * axis, (8, 1))
        assert policy.stiffness @ axis == pytest.approx(expected, abs=2.0)  # no coupling either
    within = axes[still:] @ policy.stiffness @ axes[still:].T
    values = np.linalg.eigvalsh(within)
    assert values.min() == pytest.approx(150.0, abs=2.0)
    assert values.max() == pytest.approx(500.0, abs=2.0)


def test_the_same_movement_at_two_speeds_is_fitted_as_one_of_the_mean_speed() -> None:
    demonstration = toss()

    def slower(factor: float) -> Demonstration:
        return replace(
            demonstration,
            t=demonstration.t * factor,
            velocity=demonstration.velocity / factor,
            acceleration=demonstration.acceleration / factor**2,
            period=demonstration.period * factor,
        )

    both = fit([demonstration, slower(1.4)], FLIP_FIT, "p")
    mean = fit([slower(1.2)], FLIP_FIT, "p")
    assert both.basis.duration == pytest.approx(mean.basis.duration)
    assert both.attractors == pytest.approx(mean.attractors, abs=1e-6)
    assert both.rotation_attractors == pytest.approx(mean.rotation_attractors, abs=1e-6)


def test_a_movement_gets_as_many_springs_as_it_needs_and_no_more() -> None:
    demonstration = toss()
    each = [FLIP_FIT.with_count(count) for count in (8, 16)]
    fitted = [fit([demonstration], settings, "p") for settings in each]
    loss = {policy.basis.count: path_error(policy, [demonstration]) for policy in fitted}
    for error, count in ((1.01 * loss[8], 8), (1.01 * loss[16], 16), (1e-9, REFINED_MAX)):
        assert fit([demonstration], replace(FLIP_FIT, error=error), "p").basis.count == count
    assert fitted[0].basis.count == 8  # without a wanted error


def test_start_and_orientation_reference_are_those_of_the_first_demonstration() -> None:
    first, other = toss(), toss(400)
    turn = rotations.quat_of_vector(np.array([0.3, 0.0, 0.0]))
    quat = rotations.multiply(np.broadcast_to(turn, (400, 4)), other.quat_xyzw)
    moving = first.q + np.outer(first.t, np.ones(7))
    other = replace(other, q=other.q + 0.5, quat_xyzw=quat)
    policy = fit([replace(first, q=moving), other], FLIP_FIT, "p")
    assert np.array_equal(policy.q_start, moving[0])
    assert np.array_equal(policy.orientation_reference, first.quat_xyzw[0])


def test_a_demonstration_that_never_moves_or_is_short_gives_a_policy_too() -> None:
    policy = fit([from_positions(np.tile([0.7, 0.0, 0.9], (100, 1)), DT)], FLIP_FIT, "p")
    assert policy.attractors == pytest.approx(np.tile([0.7, 0.0, 0.9], (8, 1)), abs=1e-9)
    short = from_positions(toss().position[:40], DT)  # of fewer samples than more springs need
    assert fit([short], replace(FLIP_FIT, error=1e-9), "p").basis.count == 8


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"k_min": 0.0}, "k_min"),
        ({"k_max": 100.0}, "k_min"),
        ({"width": 0.0}, "width"),
        ({"damping": math.nan}, "damping"),
    ],
)
def test_senseless_settings_are_refused(change: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        replace(FLIP_FIT, **change)


def test_no_demonstration_or_too_short_a_one_is_refused() -> None:
    with pytest.raises(ValueError, match="no demonstration"):
        fit([], FLIP_FIT, "p")
    with pytest.raises(ValueError, match="samples"):
        fit([from_positions(np.zeros((10, 3)), DT)], FitSettings(8, 0.5, 150, 500, 32), "p")
    with pytest.raises(ValueError, match="k_min"):
        positive_definite(np.eye(3)[None], 0.0)
    with pytest.raises(ValueError, match="dt"):
        tabulate(fit([toss()], FLIP_FIT, "p"), 0.0)
