# SPDX-License-Identifier: Apache-2.0
"""The figure of a rollout shows how tool and body moved, and how a body turned."""

import numpy as np
import pytest

from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
from wam_power_ros.tasks.side_view import NORMAL_LENGTH, side_view

T = np.linspace(0.0, 1.0, 101)
LEVEL = np.tile([0.0, 0.0, 0.0, 1.0], (101, 1))
TOOL = EndEffectorPath("toss", T, np.tile([0.7, 0.0, 0.4], (101, 1)), LEVEL)


def thrown(half_turns: float) -> Rollout:
    """A level tool that stays, a body that turns in a second and rises by .5 m."""
    t = T[::4]
    half = 0.5 * np.pi * half_turns * t
    quat = np.stack([0 * half, np.sin(half), 0 * half, np.cos(half)], axis=1)
    position = np.stack([0.7 + 0 * t, 0 * t, 0.4 + 2.0 * t * (1.0 - t)], axis=1)
    return Rollout(TOOL, BodyPath("toss", t, position, quat))


def test_the_normal_of_a_flipped_body_points_down_in_the_figure() -> None:
    tool, body = side_view(thrown(1.0), "pancake").axes[0].collections
    assert np.all(tool.V > 0.0)
    assert body.V[0] == pytest.approx(NORMAL_LENGTH)
    assert body.V[-1] == pytest.approx(-NORMAL_LENGTH)
