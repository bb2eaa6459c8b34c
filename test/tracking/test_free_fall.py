# SPDX-License-Identifier: Apache-2.0
"""A free fall is detected and shows the direction of gravity."""

import numpy as np
import pytest

from wam_power_ros.learning.rollout import BodyPath
from wam_power_ros.tracking.tracker import free_fall_acceleration

PAN = np.array([0.8, 0.0, 0.6])
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def path_of(position: np.ndarray) -> BodyPath:
    t = np.arange(len(position)) / 30.0
    return BodyPath("a", t, position, np.tile(LEVEL, (len(t), 1)))


def test_a_free_fall_shows_the_direction_of_gravity() -> None:
    t = np.arange(45) / 30.0
    free = np.clip(t - 0.5, 0.0, 0.6)  # carried, thrown and caught
    flight = PAN + np.stack([0.3 * free, 0.0 * t, 2.9 * free - 0.5 * 9.81 * free**2], axis=1)
    flight += np.random.default_rng(0).normal(0.0, 0.0005, flight.shape)
    down = free_fall_acceleration(path_of(flight))
    assert down[2] < -9.0 and np.linalg.norm(down[:2]) < 0.5
    swapped = flight @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]).T
    assert free_fall_acceleration(path_of(swapped))[1] < -9.0
    assert free_fall_acceleration(path_of(np.tile(PAN, (45, 1)))) is None
    for gravity, found in ((8.7, False), (8.9, True), (10.7, True), (10.9, False)):
        thrown = path_of(PAN + np.outer(4.0 * t - 0.5 * gravity * t**2, [0.0, 0.0, 1.0]))
        assert (free_fall_acceleration(thrown) is not None) == found
        if found:
            expected = [0.0, 0.0, -gravity]
            np.testing.assert_allclose(free_fall_acceleration(thrown), expected, atol=1e-6)


@pytest.mark.parametrize(("frames", "found"), [(6, False), (7, True)])
def test_two_parabolas_are_needed(frames: int, found: bool) -> None:
    t = np.arange(frames) / 30.0  # a parabola starts at each frame with at least 0.16 s after it
    position = PAN + np.outer(2.0 * t - 0.5 * 9.81 * t**2, [0.0, 0.0, 1.0])
    assert (free_fall_acceleration(path_of(position)) is not None) == found
