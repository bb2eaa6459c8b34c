# SPDX-License-Identifier: Apache-2.0
"""Vector error of a toss, rotation, landing and catch: measured, and predicted for a simulated pan.

The simulated arm carries the pan along a path, and `pan_toss` predicts what the pancake does there.
How much drag slows its spin is a number that rollouts tell, see `learner.Prediction`; what else the
model leaves out is for a learner to find from them, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from wam_power_ros.learning.learner import Prediction
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Foreseen
from wam_power_ros.tasks.errors import Effect, Error, RoughErrors
from wam_power_ros.tasks.flip.pan_toss import Pancake, predict_toss
from wam_power_ros.tasks.flip.parametrization import TURN_OF_FLICK, TURN_OF_TEMPO, TURN_OF_VIGOUR
from wam_power_ros.tasks.flip.settings import FlipSettings

# From a pitch of 15 degrees on pancakes slide off the pan.
ERRORS = (
    Error("rotation", "rad", math.radians(15.0)),
    Error("landing_x", "m", 0.03),
    Error("landing_y", "m", 0.03),
    Error("catch_pitch", "rad", math.radians(12.0)),
)
SPIN_DECAY_SD = 0.3  # standard deviation of `Pancake.spin_decay` [1/rad]
PANCAKE = Pancake()
SLOWED = PANCAKE._replace(spin_decay=PANCAKE.spin_decay + SPIN_DECAY_SD)
EFFECTS = (
    Effect("vigour", 0.3, {"rotation": TURN_OF_VIGOUR}),
    Effect("tempo", 0.15, {"rotation": TURN_OF_TEMPO}),
    Effect("flick", 0.3, {"rotation": TURN_OF_FLICK}),
    Effect("catch_shift", 0.25, {"landing_x": -1.0}),
    Effect("side_shift", 0.25, {"landing_y": -1.0}),
    Effect("catch_pitch", 0.25, {"catch_pitch": -1.0}),
)


def measured_errors(flight: Mapping[str, Any]) -> dict[str, float] | None:
    """Errors of an observed toss, see `ERRORS`; None if the pancake was not observed."""
    if flight["tossed"] and not flight["seen"]:
        return None
    tossed, angle = bool(flight["tossed"]), flight["angle"]
    return _errors(tossed, angle, flight["landing_error"][:2], flight["catch_pitch"])


def _errors(
    tossed: bool, angle: float, landing_error: Sequence[float], catch_pitch: float
) -> dict[str, float]:
    """Errors of a toss; a pancake that was not tossed has not turned, and has no landing."""
    turned = {"rotation": angle - math.pi}
    if not tossed:
        return turned
    x, y = landing_error
    return {**turned, "landing_x": x, "landing_y": y, "catch_pitch": catch_pitch}


class TossErrors(RoughErrors):
    """A `learner.ErrorModel` of a toss: `ERRORS`, predicted for a simulated pan."""

    def __init__(
        self,
        parametrization: Parametrization,
        foresee: Callable[[Policy], Foreseen | None],
        settings: FlipSettings,
    ) -> None:
        """See `Task.error_model`."""
        super().__init__(ERRORS, EFFECTS, parametrization)
        self._parametrization, self._foresee = parametrization, foresee
        self._settings = settings
        self._known: dict[bytes, Prediction | None] = {}  # by coordinates; a simulation is slow

    def predict(self, z: np.ndarray) -> Prediction | None:
        """See `learner.ErrorModel`."""
        key = z.tobytes()
        if key not in self._known:
            policy, _ = self._parametrization.policy(z, "predicted")
            foreseen, prediction = self._foresee(policy), None
            if foreseen is not None:
                error, slowed = (self._error(foreseen, each) for each in (PANCAKE, SLOWED))
                change = slowed - error
                known = np.isfinite(change).all()  # both are tosses
                uncertain = np.where(known, change, 0.0)[:, np.newaxis]
                prediction = Prediction(error, foreseen.excess, uncertain)
            self._known[key] = prediction
        return self._known[key]

    def _error(self, foreseen: Foreseen, pancake: Pancake) -> np.ndarray:
        errors = _errors(*predict_toss(foreseen.tool, self._settings.delta_h, pancake))
        return np.array([errors.get(each.name, math.nan) for each in ERRORS]) / self.tolerances
