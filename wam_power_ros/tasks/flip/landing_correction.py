# SPDX-License-Identifier: Apache-2.0
"""Hindsight correction: shift z by what landing and rotation missed, for lack of a toss too."""

from __future__ import annotations

import math

import numpy as np

from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.tasks.flip.parametrization import TURN_OF_FLICK, TURN_OF_TEMPO, TURN_OF_VIGOUR
from wam_power_ros.tasks.flip.settings import FlipSettings
from wam_power_ros.tasks.task import Assessment


def landing_correction(
    assessment: Assessment, parametrization: Parametrization, settings: FlipSettings
) -> list[np.ndarray]:
    """Shifts of catch shift, flick, vigour and tempo by what landing and rotation missed.

    The catch shift goes to where the pancake came down, the others to where it would have made half
    a turn. A pancake that was not thrown made none of it, so all of it is missing.

    Args:
        assessment: Assessment of a rollout, with its flight as the observation.
        parametrization: Meaning of the coordinates.
        settings: Gains and limits.

    Returns:
        Shifts of z, shape (size,) each; none without gains, or when the toss was not seen.
    """
    flight = assessment.observation
    if flight is None or (flight["tossed"] and not flight["seen"]):
        return []
    missing = math.pi - float(flight["angle"])  # of half a turn
    error = float(flight["landing_error"][0])  # along x
    shifts = []
    for group, gain, wanted, limit in (
        ("catch_shift", settings.landing_gain, error, settings.landing_limit),
        ("flick", settings.turn_gain, missing / TURN_OF_FLICK, settings.turn_limit),
        ("vigour", settings.vigour_gain, missing / TURN_OF_VIGOUR, settings.vigour_limit),
        ("tempo", settings.tempo_gain, missing / TURN_OF_TEMPO, settings.tempo_limit),
    ):
        if gain and wanted:
            index = parametrization.groups[group]
            shift = np.zeros(parametrization.size)
            shift[index] = float(np.clip(gain * wanted, -limit, limit))
            shifts.append(shift / parametrization.scale)
    return shifts
