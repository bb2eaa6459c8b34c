# SPDX-License-Identifier: Apache-2.0
"""Hindsight correction of a toss: shift z by the measured errors of landing, rotation and pitch."""

from __future__ import annotations

import math

import numpy as np

from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.tasks.flip.flight import FLIP_ANGLES
from wam_power_ros.tasks.flip.parametrization import TURN_OF_FLICK, TURN_OF_TEMPO, TURN_OF_VIGOUR
from wam_power_ros.tasks.flip.settings import FlipSettings
from wam_power_ros.tasks.task import Assessment


def landing_correction(
    assessment: Assessment, parametrization: Parametrization, settings: FlipSettings
) -> list[np.ndarray]:
    """Correct catch and side shift, catch pitch, flick, vigour and tempo by the measured errors.

    The shifts are moved to where the pancake came down, the pitch to a level pan, from which one
    that has turned does not slide, the others to where it would have made half a turn. A pancake
    that was not tossed has not turned, so it lacks the whole half turn.

    Returns:
        Shifts of z, shape (size,) each; empty without gains, or if the toss was not seen.
    """
    flight = assessment.observation
    if flight is None or (flight["tossed"] and not flight["seen"]):
        return []
    missing = math.pi - float(flight["angle"])  # rotation missing to half a turn [rad]
    error, aside = (float(each) for each in flight["landing_error"][:2])  # along x, y [m]
    # Of a pancake that has turned: under another, the pan is still in its flick.
    low, high = FLIP_ANGLES
    pitch = float(flight["catch_pitch"]) if low <= flight["angle"] <= high else 0.0
    shifts = []
    for group, gain, wanted, limit in (
        ("catch_shift", settings.landing_gain, error, settings.landing_limit),
        ("side_shift", settings.landing_gain, aside, settings.landing_limit),
        ("catch_pitch", settings.level_gain, pitch, settings.level_limit),
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
