# SPDX-License-Identifier: Apache-2.0
"""Errors of a toss, rotation, landing and catch, and what moves them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from wam_power_ros.tasks.errors import Effect, Error
from wam_power_ros.tasks.flip.pan_toss import PANCAKE
from wam_power_ros.tasks.flip.parametrization import TURN_OF_AMPLITUDE, TURN_OF_TEMPO, TURN_OF_WRIST

ERRORS = (
    Error("rotation", "rad", math.radians(15.0), math.radians(30.0), math.radians(5.0)),
    Error("landing_x", "m", 0.03),
    Error("landing_y", "m", 0.03),
    # From a pitch of 15 degrees on pancakes slide off the pan.
    Error("catch_pitch", "rad", math.radians(12.0)),
    # Up to a miss of 0.08 m a pancake that had turned was caught in 98 % of 3084 simulated tosses:
    # below 0.06 m in 99 %, from there on in 93 %, and from 0.08 to 0.10 m in 82 %.
    Error("miss", "m", 0.03, limit=0.08, scatter=0.015),
    # Of 21 that climbed the rim to 32 to 49 mm after their fall, all slid back, of 8 above two.
    Error("climb", "m", 0.01, limit=0.045, scatter=0.004),
    Error("apex", "m", 0.025, limit=0.05, scatter=0.012),  # counts if a goal asks for one
)
APEX_OF_AMPLITUDE = 0.7  # [m] per unit, or per log tempo, measured on tosses of tuning seeds
EFFECTS = (
    Effect("amplitude", 0.3, {"rotation": TURN_OF_AMPLITUDE, "apex": APEX_OF_AMPLITUDE}),
    Effect("tempo", 0.15, {"rotation": TURN_OF_TEMPO, "apex": APEX_OF_AMPLITUDE}),
    Effect("wrist_amplitude", 0.3, {"rotation": TURN_OF_WRIST}),
    Effect("catch_shift", 0.25, {"landing_x": -1.0}),
    Effect("side_shift", 0.25, {"landing_y": -1.0}),
    Effect("catch_pitch", 0.25, {"catch_pitch": -1.0}),
)
DOUBT = {"spin_decay": 0.3, "friction": -0.04, "radius": 0.01}  # one standard deviation
PANCAKES = (PANCAKE, *(PANCAKE._replace(**{k: getattr(PANCAKE, k) + v}) for k, v in DOUBT.items()))


def measured_errors(flight: Mapping[str, Any]) -> dict[str, float] | None:
    """Errors of an observed toss, see `ERRORS`; None if the pancake was not observed."""
    if not flight.get("seen", False):
        return None
    x, y = flight["landing_error"][:2]
    found = {"rotation": flight["angle"] - math.pi, "landing_x": x, "landing_y": y}
    found |= {"catch_pitch": flight["catch_pitch"], "miss": math.hypot(x, y)}
    return found | {name: flight[name] for name in ("climb", "apex") if name in flight}
