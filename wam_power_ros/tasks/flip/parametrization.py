# SPDX-License-Identifier: Apache-2.0
"""Parametrization of a toss: its policy, amplitude, tempo, wrist amplitude and catch shift."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from wam_power_ros.learning.parametrization import (
    Attractors,
    Direction,
    NoiseScales,
    Parametrization,
    Rotation,
    Stiffness,
    Tempo,
    parametrization_of,
    seen_from,
)
from wam_power_ros.learning.policy import Policy

PLANE = (0, 2)  # axes of the movement
# Share of a shift or pitch that an attractor gets, by its place in the movement [1]. With the 8 of
# the paper the last three get 0.5, 1 and 1.
CATCH = ((4.0 / 7.0, 6.0 / 7.0), (0.0, 1.0))
TURN_OF_WRIST = 2.0  # additional rotation per unit, measured on wrist flicks [rad]
TURN_OF_AMPLITUDE = 3.0  # additional rotation per unit of amplitude [rad]
# Additional rotation per unit of log tempo [rad]: both spin and time of flight, whose product is a
# rotation of pi, are proportional to the tempo.
TURN_OF_TEMPO = 6.0


class FlipNoise(NoiseScales):
    """Standard deviation of the exploration noise of a toss."""

    amplitude: float = Field(default=0.05, gt=0.0, le=1.0)  # [1]
    tempo: float = Field(default=0.03, gt=0.0, le=1.0)  # of its logarithm [1]
    wrist_amplitude: float = Field(default=0.05, gt=0.0, le=1.0)  # [1]
    catch_shift: float = Field(gt=0.0, le=1.0)  # [m]


def flip_parametrization(
    policy: Policy, variant: str, noise: FlipNoise, heading: float = 0.0
) -> Parametrization:
    """Parametrization of a toss around a demonstrated policy.

    The variant "planar" is of a movement in the x-z plane of axes that are turned about the
    vertical by a heading [rad]: K_xx, K_zz and K_xz, mu_x and mu_z, the
    rotation attractor about y (pitch), the tempo, and five more parameters:
        amplitude: Scales the demonstrated movement in the plane, mu_i - mu_1 and r_i - r_1, by
            1 + amplitude [1]. Eq. 1 is linear in its attractors, so all speeds and accelerations
            grow by the same factor, in the same time.
        wrist_amplitude: Scales the demonstrated rotation about y, r_i - r_1, by 1 + this [1].
        catch_shift: Moves mu_x of the attractors of the catch by this [m], see `CATCH`.
        catch_pitch: Turns their r_i about y in the same way [rad]: the pan that catches is lower in
            front.
        side_shift: Moves their mu_y in the same way [m]: a pan that is not level, or a tilted base,
            tosses to the side.

    Raises:
        ValueError: If the variant is unknown.
    """
    if variant != "planar":
        return parametrization_of(policy, variant, noise)
    n = policy.basis.count
    swing, turn, shift, side, level, zeros = np.zeros((6, n, 3))
    seen = seen_from(policy, heading)
    swing[:, [0, 2]] = (seen.attractors - seen.attractors[0])[:, [0, 2]]
    pitch = seen.rotation_attractors[:, 1]
    turn[:, 1] = pitch - pitch[0]
    caught = np.interp(np.linspace(0.0, 1.0, n), *CATCH).round(9)
    shift[:, 0] = side[:, 1] = level[:, 1] = caught
    groups = (
        Stiffness(noise.stiffness, "symmetric", PLANE),
        Attractors(noise.attractor, PLANE),
        Rotation(noise.rotation, (1,)),
        Direction(noise.catch_shift, "side_shift", attractors=side, rotation=zeros),
        Direction(noise.rotation, "catch_pitch", attractors=zeros, rotation=level),
        Direction(noise.amplitude, "amplitude", attractors=swing, rotation=turn),
        Direction(noise.wrist_amplitude, "wrist_amplitude", attractors=zeros, rotation=turn),
        Direction(noise.catch_shift, "catch_shift", attractors=shift, rotation=zeros),
        Tempo(noise.tempo),
    )
    return Parametrization(policy, groups, heading)
