# SPDX-License-Identifier: Apache-2.0
"""Parametrization of a swing: its attractors, vigour and catch shift."""

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

CATCH_PROFILE = (0.5, 1.0, 1.0, 1.0)  # shift of the last attractors per unit of catch shift [1]
PLANE = (0, 2)  # axes of the movement
SHIFTS = ("catch_shift_x", "catch_shift_y")


def cup_parametrization(policy: Policy, variant: str, noise: CupNoise) -> Parametrization:
    """Parametrization of a swing around a demonstrated policy.

    The variant "swing" has the attractors mu_x and mu_z, in the plane of the swing, and
        vigour: Scales the demonstrated movement, mu_i - mu_1 and r_i - r_1, by 1 + vigour [1].
        catch_shift_x, catch_shift_y: Move the last attractors, where the ball is caught [m].

    Raises:
        ValueError: If the variant is unknown, or "swing" with fewer attractors than are shifted.
    """
    if variant != "swing":
        return parametrization_of(policy, variant, noise)
    n, last = policy.basis.count, len(CATCH_PROFILE)
    if n < last:
        text = f"variant {variant!r} shifts the last {last} attractors"
        raise ValueError(f"{text}, policy {policy.id!r} has {n}")
    shift_x, shift_y, zeros = np.zeros((3, n, 3))
    shift_x[-last:, 0] = shift_y[-last:, 1] = CATCH_PROFILE
    swing = policy.attractors - policy.attractors[0]
    turn = policy.rotation_attractors - policy.rotation_attractors[0]
    groups = (
        Attractors(noise.attractor, PLANE),
        Direction(noise.vigour, "vigour", attractors=swing, rotation=turn),
        Direction(noise.catch_shift, SHIFTS[0], attractors=shift_x, rotation=zeros),
        Direction(noise.catch_shift, SHIFTS[1], attractors=shift_y, rotation=zeros),
    )
    return Parametrization(policy, groups)
