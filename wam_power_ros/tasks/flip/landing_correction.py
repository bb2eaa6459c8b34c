# SPDX-License-Identifier: Apache-2.0
"""Hindsight correction: shift z by the measured landing and rotation error of a toss."""

from __future__ import annotations

import math

import numpy as np

from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.tasks.flip.parametrization import TURN_OF_FLICK
from wam_power_ros.tasks.flip.settings import FlipSettings
from wam_power_ros.tasks.task import Assessment


def landing_correction(
    assessment: Assessment, parametrization: Parametrization, settings: FlipSettings
) -> np.ndarray | None:
    """Shift of the catch shift and the flick by what landing and rotation missed.

    The catch shift goes to where the pancake came down, the flick to where it would have made
    half a turn.

    Args:
        assessment: Assessment of a rollout, with its flight as the observation.
        parametrization: Meaning of the coordinates.
        settings: Gains and limits.

    Returns:
        Shift of z, shape (size,); None without gains or without a toss that was seen.
    """
    flight = assessment.observation
    if not (settings.landing_gain or settings.turn_gain):
        return None
    if flight is None or not (flight["tossed"] and flight["seen"]):
        return None
    shift = settings.landing_gain * float(flight["landing_error"][0])  # along x
    flick = settings.turn_gain * (math.pi - float(flight["angle"])) / TURN_OF_FLICK
    moved = np.zeros(parametrization.size)
    for group, value, limit in (
        ("catch_shift", shift, settings.landing_limit),
        ("flick", flick, settings.turn_limit),
    ):
        index = parametrization.groups[group]
        moved[index] = float(np.clip(value, -limit, limit)) / parametrization.scale[index]
    return moved
