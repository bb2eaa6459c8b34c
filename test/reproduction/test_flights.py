# SPDX-License-Identifier: Apache-2.0
"""The figure of flights shows both sides of a pancake."""

import numpy as np
import pytest

from reproduction.flights import flights
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath


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


def test_a_flipped_pancake_shows_its_other_side() -> None:
    pan, pancake = a_toss()
    axes = flights({"flipped": (pan, pancake, 0.9)}).axes[0]
    upper = [np.mean(line.get_ydata()) for line in axes.lines if line.get_color() == "#e3a72f"]
    lower = [np.mean(line.get_ydata()) for line in axes.lines if line.get_color() == "#7a4a1c"]
    lower = lower[1:]  # the first brown line is the path
    assert upper[0] > lower[0] and upper[-1] < lower[-1]
    mark = next(line for line in axes.lines if line.get_label() == "$t_f$")
    assert mark.get_ydata()[0] == pytest.approx(np.interp(0.9, pancake.t, pancake.position[:, 2]))
