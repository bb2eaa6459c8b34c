# SPDX-License-Identifier: Apache-2.0
"""What the outcome of a toss says about the policy that would have done it right."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.practice.trial import Trial
from wam_power_ros.tasks.flip.assessment import Assessment
from wam_power_ros.tasks.flip.parametrization import TURN_OF_FLICK


def corrected(
    trial: Trial,
    assessment: Assessment,
    parameters: Parametrization,
    settings: PracticeSettings,
    forbidden: Callable[[Policy], str],
) -> np.ndarray:
    """The trial's z with its catch shift and its flick moved by what landing and turn missed.

    The catch shift goes to where the pancake came down, the flick to where it would have made
    half a turn: errors with a direction, which a return does not have.

    Args:
        trial: as it was executed.
        assessment: of its rollout.
        parameters: those of its demonstration.
        settings: gains and limits; without gains, or without a toss that was seen, z stays.
        forbidden: why the arm must not try a policy, empty if it may.

    Returns:
        Coordinates as the learner is told them. Shape (size,)
    """
    flight = assessment.flight
    if not (settings.landing_gain or settings.turn_gain):
        return trial.z
    if flight is None or not (flight["tossed"] and flight["seen"]):
        return trial.z
    shift = settings.landing_gain * float(flight["landing_error"][0])  # along x
    flick = settings.turn_gain * (math.pi - float(flight["angle"])) / TURN_OF_FLICK
    moved = np.zeros(parameters.size)
    for group, value, limit in (
        ("catch_shift", shift, settings.landing_limit),
        ("flick", flick, settings.turn_limit),
    ):
        index = parameters.groups[group]
        moved[index] = float(np.clip(value, -limit, limit)) / parameters.scale[index]
    for share in (1.0, 0.5, 0.25):  # not to where the arm cannot follow
        z = trial.z + share * moved
        if not forbidden(parameters.policy(z, "corrected")[0]):
            return z
    return trial.z
