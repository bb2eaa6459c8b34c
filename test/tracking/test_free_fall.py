# SPDX-License-Identifier: Apache-2.0
"""A free fall is detected and shows the direction of gravity."""

import numpy as np
import pytest

from wam_power_ros.learning.rollout import BodyPath
from wam_power_ros.tracking.tracker import free_fall_acceleration

PAN = np.array([0.8, 0.0, 0.6])
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def flight(axes: np.ndarray) -> BodyPath:
    """Path of a body carried, thrown and caught, at 30 Hz with noise, in rotated `axes` (3, 3)."""
    t = np.arange(45) / 30.0
    free = np.clip(t - 0.5, 0.0, 0.6)
    position = PAN + np.stack([0.3 * free, 0.0 * t, 2.9 * free - 0.5 * 9.81 * free**2], axis=1)
    position += np.random.default_rng(0).normal(0.0, 0.0005, position.shape)
    quat = np.repeat(LEVEL[None], len(t), axis=0)
    return BodyPath(id="a", t=t, position=position @ axes.T, quat_xyzw=quat)


def test_a_free_fall_shows_the_direction_of_gravity() -> None:
    down = free_fall_acceleration(flight(np.eye(3)))
    assert down[2] < -9.0
    assert np.linalg.norm(down[:2]) < 0.5
    swapped = free_fall_acceleration(flight(np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])))
    assert swapped[1] < -9.0
    for gravity, found in ((8.7, False), (8.9, True), (10.7, True), (10.9, False)):
        t = np.arange(45) / 30.0
        position = PAN + np.outer(4.0 * t - 0.5 * gravity * t**2, [0.0, 0.0, 1.0])
        thrown = BodyPath("a", t, position, np.repeat(LEVEL[None], 45, axis=0))
        assert (free_fall_acceleration(thrown) is not None) == found
        if found:
            np.testing.assert_allclose(
                free_fall_acceleration(thrown), [0.0, 0.0, -gravity], atol=1e-6
            )
    still = BodyPath(
        id="a",
        t=np.arange(45) / 30.0,
        position=np.repeat(PAN[None], 45, axis=0),
        quat_xyzw=np.repeat(LEVEL[None], 45, axis=0),
    )
    assert free_fall_acceleration(still) is None


@pytest.mark.parametrize(("frames", "found"), [(6, False), (7, True)])
def test_two_parabolas_are_needed(frames: int, found: bool) -> None:
    t = np.arange(frames) / 30.0  # a parabola starts at each frame with at least 0.16 s after it
    position = PAN + np.outer(2.0 * t - 0.5 * 9.81 * t**2, [0.0, 0.0, 1.0])
    path = BodyPath("a", t, position, np.repeat(LEVEL[None], frames, axis=0))
    assert (free_fall_acceleration(path) is not None) == found
