# SPDX-License-Identifier: Apache-2.0
"""Parametrization of a toss: its policy, vigour, tempo, a flick and a catch shift."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from wam_power_ros.learning.parametrization import Direction, NoiseScales, Parametrization
from wam_power_ros.learning.policy import Policy

CATCH_PROFILE = (0.5, 1.0, 1.0)  # shift of the last three attractors for a catch shift of one [1]
TURN_OF_FLICK = 2.0  # additional turn of a toss for a flick of one, measured on wrist flicks [rad]
TURN_OF_VIGOUR = 3.0  # the same for a vigour of one [rad]
# For a log tempo of one: spin and time of flight grow with it, and half a turn with both [rad].
TURN_OF_TEMPO = 6.0


class FlipNoise(NoiseScales):
    """Standard deviation of the exploration noise of a toss.

    Attributes:
        vigour: Noise of the vigour [1].
        tempo: Noise of the logarithm of the tempo [1].
        flick: Noise of the flick [1].
        catch_shift: Noise of the catch shift [m].
    """

    vigour: float = Field(default=0.05, gt=0.0, le=1.0)
    tempo: float = Field(default=0.03, gt=0.0, le=1.0)
    flick: float = Field(default=0.05, gt=0.0, le=1.0)
    catch_shift: float = Field(gt=0.0, le=1.0)


def flip_parametrization(policy: Policy, variant: str, noise: FlipNoise) -> Parametrization:
    """Parametrization of a toss around a demonstrated policy.

    The variant "planar" learns the tempo, too, and has three parameters of its own:
        vigour: Enlarges the whole demonstrated movement in the plane, mu_i - mu_1 and r_i - r_1,
            by this share [1]: Eq. 1 is linear in its attractors, so that all speeds and
            accelerations grow by it, in the same time.
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
    swing, turn, shift, still = np.zeros((4, n, 3))
    swing[:, [0, 2]] = (policy.attractors - policy.attractors[0])[:, [0, 2]]
    pitch = policy.rotation_attractors[:, 1]
    turn[:, 1] = pitch - pitch[0]
    shift[-len(CATCH_PROFILE) :, 0] = CATCH_PROFILE
    directions = (
        Direction("vigour", noise.vigour, attractors=swing, rotation=turn),
        Direction("flick", noise.flick, attractors=still, rotation=turn),
        Direction("catch_shift", noise.catch_shift, attractors=shift, rotation=still),
    )
    return Parametrization(policy, variant, noise, directions, noise.tempo)
