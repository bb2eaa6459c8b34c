# SPDX-License-Identifier: Apache-2.0
"""Pose of a rigid body from an unlabelled marker cloud."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wam_power_ros import rotations
from wam_power_ros.tracking import marker_fit

seeds = st.integers(0, 2**32 - 1)
POSITION = np.array([0.7, -0.1, 0.5])


def cloud(rng: np.random.Generator, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The layout at a random pose and in random order, and its rotation vector."""
    vector = rng.normal(size=3)
    points = marker_fit.LAYOUT @ rotations.exp(vector).T + POSITION
    return rng.permutation(points) + rng.normal(0.0, noise, (4, 3)), vector


def angle_between(found: marker_fit.MarkerFit, vector: np.ndarray) -> float:
    inverse = rotations.quat_of_vector(-vector)
    return float(
        np.linalg.norm(rotations.rotation_vector(rotations.multiply(found.quat_xyzw, inverse)))
    )


def test_no_two_distances_of_the_layout_are_alike() -> None:
    pairs = itertools.combinations(marker_fit.LAYOUT, 2)
    distances = np.sort([np.linalg.norm(a - b) for a, b in pairs])
    assert np.diff(distances).min() > 2.0 * marker_fit.TOLERANCE
    assert np.linalg.norm(marker_fit.LAYOUT, axis=1).max() < 0.09  # on a pancake of 0.18 m


@given(seed=seeds)
@settings(max_examples=25)
def test_a_cloud_in_any_order_gives_the_pose_whatever_is_hidden_or_seen_beside_it(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    points, vector = cloud(rng)
    others = POSITION + rng.uniform(0.3, 1.0, (6, 3)) * rng.choice([-1.0, 1.0], (6, 3))
    for seen, count in ((points, 4), (points[:3], 3), (np.vstack([points, others]), 4)):
        found = marker_fit.fit(rng.permutation(seen))
        assert found.markers == count
        np.testing.assert_allclose(found.position, POSITION, atol=1e-9)
        assert angle_between(found, vector) < 1e-9


def test_half_a_millimetre_of_noise_gives_half_a_millimetre_and_half_a_degree() -> None:
    rng = np.random.default_rng(1)
    errors, angles = [], []
    for _ in range(100):
        points, vector = cloud(rng, noise=0.5e-3)
        found = marker_fit.fit(points)
        errors.append(np.linalg.norm(found.position - POSITION))
        angles.append(angle_between(found, vector))
    assert np.sqrt(np.mean(np.square(errors))) < 0.8e-3
    assert np.rad2deg(np.sqrt(np.mean(np.square(angles)))) < 0.8


@pytest.mark.parametrize(
    ("points", "why"),
    [
        (marker_fit.LAYOUT[:2], "2 markers in view"),
        (np.zeros((65, 3)), "65 markers in view"),
        (marker_fit.LAYOUT * [1.0, -1.0, 1.0] * 1.3, "not found in 4"),
        (np.full((4, 3), np.nan), "must be finite"),
        (np.vstack([marker_fit.LAYOUT, marker_fit.LAYOUT + 0.5]), "found 2 times"),
    ],
)
def test_a_cloud_without_one_clear_pose_is_refused_by_name(points: np.ndarray, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        marker_fit.fit(points)
