# SPDX-License-Identifier: Apache-2.0
"""Parametrization of a toss: that of the policy, with a flick and a catch shift."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from wam_power_ros.learning.parametrization import Direction, NoiseScales, Parametrization
from wam_power_ros.learning.policy import Policy

CATCH_PROFILE = (0.5, 1.0, 1.0)  # shift of the last three attractors for a catch shift of one [1]
TURN_OF_FLICK = 2.0  # additional turn of a toss for a flick of one, measured on wrist flicks [rad]


class FlipNoise(NoiseScales):
    """Standard deviation of the exploration noise of a toss.

    Attributes:
        flick: Noise of the flick [1].
        catch_shift: Noise of the catch shift [m].
    """

    flick: float = Field(default=0.05, gt=0.0, le=1.0)
    catch_shift: float = Field(gt=0.0, le=1.0)


def flip_parametrization(policy: Policy, variant: str, noise: FlipNoise) -> Parametrization:
    """Parametrization of a toss around a demonstrated policy.

    The variant "planar" has two more parameters than `Parametrization`:
        flick: Enlarges the demonstrated turn of the pan, r_i - r_1 about y, by this share [1].
        catch_shift: Moves mu_x of the last three attractors by 0.5, 1 and 1 times this [m].

    Raises:
        ValueError: If the variant is unknown, or "planar" with fewer than three attractors.
    """
    if variant != "planar":
        return Parametrization(policy, variant, noise)
    n = policy.basis.count
    if n < len(CATCH_PROFILE):
        raise ValueError(
            f"variant {variant!r} shifts the last {len(CATCH_PROFILE)} attractors, "
            f"policy {policy.id!r} has {n}"
        )
    turn, shift, still = np.zeros((3, n, 3))
    pitch = policy.rotation_attractors[:, 1]
    turn[:, 1] = pitch - pitch[0]
    shift[-len(CATCH_PROFILE) :, 0] = CATCH_PROFILE
    directions = (
        Direction("flick", noise.flick, attractors=still, rotation=turn),
        Direction("catch_shift", noise.catch_shift, attractors=shift, rotation=still),
    )
    return Parametrization(policy, variant, noise, directions)
