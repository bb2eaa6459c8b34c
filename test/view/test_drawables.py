# SPDX-License-Identifier: Apache-2.0
"""Movements as arrays for drawing."""

from __future__ import annotations

import numpy as np

from wam_power_ros.view.drawables import Movement


def movement() -> Movement:
    t = np.array([0.0, 1.0, 2.0])
    seen = np.array([[0.5, 0.0, 0.0], [0.6, 0.0, 0.0]])
    quats = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])
    q = np.array([[0.0, 4.0], [1.0, 4.0], [3.0, 4.0]])
    return Movement("m", "", ("a", "b"), t, q, "ball", np.array([0.5, 1.5]), seen, quats, None)


def test_joints_are_interpolated_and_stay_at_the_ends() -> None:
    for t, expected in ((-1.0, [0.0, 4.0]), (1.5, [2.0, 4.0]), (9.0, [3.0, 4.0])):
        np.testing.assert_allclose(movement().joints_at(t), expected)
    assert movement().duration == 2.0


def test_a_body_is_where_it_was_last_seen_and_nowhere_before() -> None:
    assert movement().body_at(0.4) is None
    position, quat = movement().body_at(1.7)
    assert position.tolist() == [0.6, 0.0, 0.0] and quat.tolist() == [0.0, 1.0, 0.0, 0.0]
