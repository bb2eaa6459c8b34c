# SPDX-License-Identifier: Apache-2.0
"""Conversions between rotation vectors, matrices and quaternions."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wam_power_ros import rotations

directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: math.hypot(*v) > 0.01)
angles = st.one_of(
    st.floats(0.0, math.pi), st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 1e-4, math.pi - 1e-9])
)


def vector(direction: tuple[float, float, float], angle: float) -> np.ndarray:
    return angle * np.array(direction) / math.hypot(*direction)


@settings(max_examples=60)
@given(directions, angles)
def test_log_undoes_exp_from_zero_to_half_a_turn(
    direction: tuple[float, float, float], angle: float
) -> None:
    r = vector(direction, angle)
    matrix = rotations.exp(r)
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    assert rotations.exp(rotations.log(matrix)) == pytest.approx(matrix, abs=1e-12)
    if angle < math.pi - 1e-6:
        assert rotations.log(matrix) == pytest.approx(r, abs=1e-9)


@settings(max_examples=60)
@given(directions, angles)
def test_quaternion_and_matrix_are_the_same_rotation(
    direction: tuple[float, float, float], angle: float
) -> None:
    r = vector(direction, angle)
    quat = rotations.quat_of_vector(r)
    assert rotations.matrix(quat) == pytest.approx(rotations.exp(r), abs=1e-12)
    assert rotations.matrix(-3.0 * quat) == pytest.approx(rotations.exp(r), abs=1e-12)
    back = rotations.quat_xyzw(rotations.exp(r))
    assert min(np.abs(back - quat).max(), np.abs(back + quat).max()) < 1e-9
    assert rotations.exp(rotations.rotation_vector(-quat)) == pytest.approx(
        rotations.exp(r), abs=1e-12
    )


def test_a_turn_about_z_takes_x_to_y() -> None:
    r = np.array([0.0, 0.0, 0.5 * math.pi])
    assert rotations.exp(r) @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0])
    root = math.sqrt(0.5)
    assert rotations.quat_of_vector(r) == pytest.approx([0.0, 0.0, root, root])


def test_many_at_once_give_what_one_at_a_time_gives() -> None:
    r = np.random.default_rng(0).normal(size=(5, 4, 3))
    matrix = rotations.exp(r)
    quat = rotations.quat_xyzw(matrix)
    assert rotations.log(matrix).shape == (5, 4, 3)
    for i in np.ndindex(5, 4):
        assert np.allclose(rotations.exp(r[i]), matrix[i], atol=1e-15)
        assert np.allclose(rotations.quat_xyzw(matrix[i]), quat[i], atol=1e-15)
        assert np.allclose(rotations.rotation_vector(quat[i]), rotations.log(matrix)[i], atol=1e-14)


def test_the_product_of_quaternions_is_the_product_of_matrices() -> None:
    a, b = np.random.default_rng(1).normal(size=(2, 10, 4))
    product = rotations.matrix(rotations.multiply(a, b))
    assert product == pytest.approx(rotations.matrix(a) @ rotations.matrix(b), abs=1e-12)


def test_two_whole_turns_come_out_without_a_jump() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    angle = np.linspace(0.1, 4.0 * math.pi - 0.1, 101)
    folded = rotations.log(rotations.exp(angle[:, None] * axis))
    assert np.linalg.norm(folded, axis=1).max() <= math.pi + 1e-12
    assert rotations.continuous(folded) == pytest.approx(angle[:, None] * axis, abs=1e-9)


def test_interpolation_turns_at_a_constant_rate_and_holds_outside() -> None:
    times = np.array([0.0, 1.0, 3.0])
    quats = rotations.quat_of_vector(np.outer([0.0, 1.0, -1.0], [0.0, 0.6, 0.8]))
    t = np.array([-1.0, 0.25, 1.0, 2.5, 9.0])
    r = rotations.rotation_vector(rotations.interpolate(t, times, quats))
    assert r == pytest.approx(np.outer([0.0, 0.25, 1.0, -0.5, -1.0], [0.0, 0.6, 0.8]), abs=1e-12)
    flipped = rotations.interpolate(t, times, quats * np.array([[1.0], [-1.0], [1.0]]))
    assert rotations.rotation_vector(flipped) == pytest.approx(r, abs=1e-12)


@pytest.mark.parametrize("quat", [[0.0] * 4, [math.nan, 0.0, 0.0, 1.0], [math.inf, 0.0, 0.0, 1.0]])
def test_a_quaternion_without_direction_is_refused(quat: list[float]) -> None:
    with pytest.raises(ValueError, match="quaternion"):
        rotations.matrix(quat)
