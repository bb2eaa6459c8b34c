# SPDX-License-Identifier: Apache-2.0
"""Parametrization of a swing: its attractors, vigour and sideways shift."""

from __future__ import annotations

import numpy as np

from wam_power_ros.learning.parametrization import (
    Attractors,
    Direction,
    Parametrization,
    parametrization_of,
)
from wam_power_ros.learning.policy import Policy
from wam_power_ros.tasks.ball_in_cup.settings import CupNoise
from wam_power_ros.tasks.errors import direction

SWING_PLANE = (0, 2)  # axes of the movement: outward and up
SIDEWAYS_PROFILE = (0.5, 1.0)  # of the last attractors, at the catch, per unit of the shift [1]


def cup_parametrization(policy: Policy, variant: str, noise: CupNoise) -> Parametrization:
    """Parametrization of a swing around a demonstrated policy.

    The variant "swing" has the attractors mu_x and mu_z, in the plane of the swing, and
        vigour: Scales the demonstrated movement, mu_i - mu_1 and r_i - r_1, by 1 + vigour [1].
        sideways: Moves the last attractors along y, out of the plane of the swing [m]. A shift in
            the plane would throw the ball as far again.

    Raises:
        ValueError: If the variant is unknown, or "swing" with fewer attractors than are shifted.
    """
    if variant != "swing":
        return parametrization_of(policy, variant, noise)
    n, last = policy.basis.count, len(SIDEWAYS_PROFILE)
    if n < last:
        text = f"variant {variant!r} shifts the last {last} attractors"
        raise ValueError(f"{text}, policy {policy.id!r} has {n}")
    sideways, still = np.zeros((2, n, 3))
    sideways[-last:, 1] = SIDEWAYS_PROFILE
    groups = (
        Attractors(noise.attractor, SWING_PLANE),
        direction(policy, "vigour", noise.vigour),
        Direction(noise.sideways, "sideways", attractors=sideways, rotation=still),
    )
    return Parametrization(policy, groups)
