# SPDX-License-Identifier: Apache-2.0
"""The movement of the hand whose force the benchmark of the commissioning measures."""

from __future__ import annotations

import numpy as np

from benchmark.commissioning import HAND_SPEED, RADIUS, Circle
from wam_power_ros import rotations


def test_the_hand_moves_in_a_circle_from_rest_at_one_speed() -> None:
    script, start = Circle(), np.array([0.6, 0.1, 0.5])
    turn = rotations.exp(np.array([0.1, -0.3, 0.7]))
    t = np.arange(0.0, script.end, 1e-3)
    targets = [script.target(each, start, turn) for each in t]
    place, velocity = (np.array([each[k] for each in targets]) for k in (0, 2))
    assert np.allclose(np.gradient(place, t, axis=0)[1:-1], velocity[1:-1], atol=2e-3)
    assert np.allclose(place[0], start)
    assert not velocity[0].any()
    fast = t > script.ease
    assert np.allclose(np.linalg.norm(velocity[fast], axis=1), HAND_SPEED)
    centre = start + np.array([0.0, 0.0, RADIUS])
    assert np.allclose(np.linalg.norm(place - centre, axis=1), RADIUS)
