# SPDX-License-Identifier: Apache-2.0
"""Figures of the pancake task show how it flew and turned."""

import numpy as np
import pytest

from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.tasks.flip import figures


def a_toss() -> tuple[EndEffectorPath, BodyPath]:
    """A level pan that stays, a pancake that turns by pi in a second and rises by .5 m."""
    t = np.linspace(0.0, 1.0, 101)
    pan = EndEffectorPath(
        "toss", t, np.tile([0.7, 0.0, 0.4], (101, 1)), np.tile([0.0, 0.0, 0.0, 1.0], (101, 1))
    )
    frames = t[::4]
    half = 0.5 * np.pi * frames
    quat = np.stack([0 * half, np.sin(half), 0 * half, np.cos(half)], axis=1)
    position = np.stack([0.7 + 0 * frames, 0 * frames, 0.4 + 2.0 * frames * (1.0 - frames)], axis=1)
    return pan, BodyPath("toss", frames, position, quat)


def test_the_normal_of_a_flipped_pancake_points_down_in_the_figure() -> None:
    side = figures.side_view(*a_toss(), t_f=0.9).axes[0]
    pan, pancake = side.collections
    assert np.all(pan.V > 0.0)
    assert pancake.V[0] == pytest.approx(figures.NORMAL_LENGTH)
    assert pancake.V[-1] == pytest.approx(-figures.NORMAL_LENGTH)


def test_a_rollout_without_a_single_frame_is_drawn_all_the_same() -> None:
    pan, _ = a_toss()
    empty = BodyPath("toss", np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))
    assert len(figures.side_view(pan, empty).axes[0].lines) == 1
