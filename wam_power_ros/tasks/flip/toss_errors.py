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
from wam_power_ros.tasks.flip.pan_toss import Pancake, predict_toss
from wam_power_ros.tasks.flip.parametrization import TURN_OF_FLICK, TURN_OF_TEMPO, TURN_OF_VIGOUR
from wam_power_ros.tasks.flip.settings import FlipSettings

TURN_TOLERANCE = math.radians(15.0)  # [rad]
LANDING_TOLERANCE = 0.03  # [m]
LEVEL_TOLERANCE = math.radians(12.0)  # [rad] of the pan; from 15 degrees on pancakes slide off
SPIN_DECAY_SD = 0.3  # standard deviation of `Pancake.spin_decay` [1/rad]
PANCAKE = Pancake()
SLOWED = PANCAKE._replace(spin_decay=PANCAKE.spin_decay + SPIN_DECAY_SD)
# Group, size of a step, and additional rotation [rad], landing error along x and y [m] and pitch at
# the catch [rad] per unit of it.
DIRECTIONS = (
    ("vigour", 0.3, (TURN_OF_VIGOUR, 0.0, 0.0, 0.0)),
    ("tempo", 0.15, (TURN_OF_TEMPO, 0.0, 0.0, 0.0)),
    ("flick", 0.3, (TURN_OF_FLICK, 0.0, 0.0, 0.0)),
    ("catch_shift", 0.25, (0.0, -1.0, 0.0, 0.0)),
    ("side_shift", 0.25, (0.0, 0.0, -1.0, 0.0)),
    ("catch_pitch", 0.25, (0.0, 0.0, 0.0, -1.0)),
)
TOLERANCES = np.array([TURN_TOLERANCE, LANDING_TOLERANCE, LANDING_TOLERANCE, LEVEL_TOLERANCE])


def measured_error(flight: Mapping[str, Any] | None) -> np.ndarray | None:
    """Errors of an observed toss: rotation, landing along x and y, pitch at the catch.

    Shape (4,), in tolerances; None if the pancake was not observed.
    """
    if flight is None or (flight["tossed"] and not flight["seen"]):
        return None
    tossed, angle = bool(flight["tossed"]), flight["angle"]
    return _error(tossed, angle, flight["landing_error"][:2], flight["catch_pitch"])


def _error(
    tossed: bool, angle: float, landing_error: Sequence[float], catch_pitch: float
) -> np.ndarray:
    """Errors in tolerances; a pancake that was not tossed has not turned, and has no landing."""
    catch = (*landing_error, catch_pitch) if tossed else (math.nan,) * 3
    return np.array([angle - math.pi, *catch]) / TOLERANCES


class TossErrors:
    """A `learner.ErrorModel` of a toss: rotation, landing along x and y, pitch at the catch.

    Attributes:
        directions: Those of the corrections in hindsight, see `DIRECTIONS`.
        slopes: Change of the errors by each.
    """

    def __init__(
        self,
        parametrization: Parametrization,
        foresee: Callable[[Policy], Foreseen | None],
        settings: FlipSettings,
    ) -> None:
        """See `Task.error_model`."""
        self._parametrization, self._foresee = parametrization, foresee
        self._settings = settings
        self._known: dict[bytes, Prediction | None] = {}  # by coordinates; a simulation is slow
        self.directions = np.zeros((len(DIRECTIONS), parametrization.size))
        self.slopes = np.zeros((len(TOLERANCES), len(DIRECTIONS)))
        for k, (group, size, changes) in enumerate(DIRECTIONS):
            index = parametrization.groups[group].start
            self.directions[k, index] = size / parametrization.scale[index]
            self.slopes[:, k] = size * np.array(changes) / TOLERANCES

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
        return _error(*predict_toss(foreseen.tool, self._settings.delta_h, pancake))
