# SPDX-License-Identifier: Apache-2.0
"""Shapes to draw a policy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from conftest import lift

from wam_power_ros import rotations
from wam_power_ros.learning.policy import PERIOD, symmetric_part
from wam_power_ros.learning.policy_shapes import PLAN_STRIDE, SEMI_AXIS_MAX, ellipsoids, plan

POLICY = lift("lift")
COUNT = POLICY.basis.count


def test_an_ellipsoid_is_long_where_the_policy_is_stiff_and_the_stiffest_has_the_given_size() -> (
    None
):
    turn = rotations.exp(np.array([0.3, -0.8, 0.5]))
    stiffness = np.stack([turn @ np.diag([100.0, 200.0, 400.0 + i]) @ turn.T for i in range(COUNT)])
    stiffness += np.array([[0.0, 9.0, 0.0], [-9.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # not symmetric
    drawn = ellipsoids(replace(POLICY, stiffness=stiffness))
    axes = rotations.matrix(np.roll(drawn.quats_wxyz, -1, axis=-1))
    again = axes @ (drawn.semi_axes[..., None] * np.swapaxes(axes, -1, -2))
    largest = np.linalg.eigvalsh(symmetric_part(stiffness)).max()
    np.testing.assert_allclose(
        again, symmetric_part(stiffness) * SEMI_AXIS_MAX / largest, atol=1e-9
    )
    np.testing.assert_array_equal(drawn.centres, POLICY.attractors)


def test_a_plan_begins_at_the_start_and_goes_where_the_attractors_are() -> None:
    start = POLICY.attractors[0] + [0.1, 0.0, 0.0]
    still = np.broadcast_to(POLICY.attractors[0], (COUNT, 3))
    path = plan(replace(POLICY, attractors=still), start)
    np.testing.assert_array_equal(path[0], start)
    assert (len(path) - 1) * PLAN_STRIDE * PERIOD == POLICY.basis.duration  # to the end
    assert np.linalg.norm(path[-1] - still[0]) < 0.5 * np.linalg.norm(start - still[0])
