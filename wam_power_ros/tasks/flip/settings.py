# SPDX-License-Identifier: Apache-2.0
"""Settings of flipping a pancake, and its presets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from wam_power_ros.learning.demonstration import Movement
from wam_power_ros.learning.dmp import FitSettings
from wam_power_ros.tasks.flip.flight import DELTA_H
from wam_power_ros.tasks.flip.parametrization import FlipNoise
from wam_power_ros.tasks.flip.returns import LandingWeights, PancakeWeights

# 8 spring-dampers as in the paper; the other values are tuned for a movement of about 0.85 s.
FLIP_FIT = FitSettings(
    count=8,
    width=0.5,
    k_min=150.0,
    k_max=500.0,
    damping=32.0,
    movement=Movement(end=0.05),  # the slow end of a catch is kept
)


# Rotation of a true flip in the air [degrees]: of a success, and in the ground truth of the
# simulator. Turned further, a pancake may still fall flat, other side up.
TRUE_TURN = (150.0, 240.0)


class FlipSettings(BaseModel):
    """Settings of the task.

    Attributes:
        variant: Learnt parameters, see `flip_parametrization`.
        noise: Standard deviation of the exploration noise of each group of parameters.
        ret: Return of the session: "eq5" (Eq. 5) or "landing" (`landing_return`).
        pancake_weights: Weights of Eq. 5.
        landing_weights: Weights of `landing_return`.
        landing_gain: Fraction of the landing error by which the catch shift of a rollout is
            corrected in hindsight [1]; 0: no correction. Needs the variant "planar".
        landing_limit: Largest correction of the catch shift per rollout [m].
        level_gain: Fraction of the pan's pitch at the catch by which the catch pitch of a rollout
            is corrected in hindsight [1]; 0: no correction. Needs the variant "planar".
        level_limit: Largest correction of the catch pitch per rollout [rad].
        turn_gain: Fraction of the rotation missing to half a turn for which the flick of a rollout
            is corrected in hindsight [1]; 0: no correction. Needs the variant "planar".
        turn_limit: Largest correction of the flick per rollout [1].
        vigour_gain: As `turn_gain`, for the vigour, which also makes the toss higher.
        vigour_limit: Largest correction of the vigour per rollout [1].
        tempo_gain: As `turn_gain`, for the logarithm of the tempo: a faster toss spins faster and
            flies longer, within the same joint range.
        tempo_limit: Largest correction of the logarithm of the tempo per rollout [1].
        success_return: Smallest return of a success; 0: any return.
        success_angle: Smallest rotation in flight of a success, which must also be caught and
            flipped [rad]; 0: no flip required.
        success_angle_max: Largest rotation of such a success [rad]; by default there is none.
        delta_h: Height above the pan at which the falling pancake is assessed [m].
        settle_time: Time that a rollout continues after the movement [s].
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    variant: Literal["full", "diagonal", "symmetric", "attractors", "planar"]
    noise: FlipNoise
    ret: Literal["eq5", "landing"]
    pancake_weights: PancakeWeights = PancakeWeights()
    landing_weights: LandingWeights = LandingWeights()
    landing_gain: float = Field(ge=0.0, le=1.0)
    landing_limit: float = Field(default=0.25, gt=0.0, le=1.0)
    level_gain: float = Field(default=0.0, ge=0.0, le=1.0)
    level_limit: float = Field(default=0.2, gt=0.0, le=1.0)
    turn_gain: float = Field(default=0.0, ge=0.0, le=1.0)
    turn_limit: float = Field(default=0.1, gt=0.0, le=1.0)
    vigour_gain: float = Field(default=0.0, ge=0.0, le=1.0)
    vigour_limit: float = Field(default=0.3, gt=0.0, le=1.0)
    tempo_gain: float = Field(default=0.0, ge=0.0, le=1.0)
    tempo_limit: float = Field(default=0.15, gt=0.0, le=1.0)
    success_return: float = Field(ge=0.0, allow_inf_nan=False)
    success_angle: float = Field(ge=0.0, allow_inf_nan=False)
    success_angle_max: float = Field(default=100.0, gt=0.0, allow_inf_nan=False)
    delta_h: float = Field(default=DELTA_H, gt=0.0, le=1.0)
    settle_time: float = Field(default=1.0, ge=0.0, le=10.0)

    @model_validator(mode="after")
    def _check_consistency(self) -> FlipSettings:
        for name in _GAINS:
            if getattr(self, name) > 0.0 and self.variant != "planar":
                raise ValueError(
                    f"{name} {getattr(self, name)} needs a parameter that only the variant "
                    f"'planar' has; the variant is {self.variant!r}"
                )
        if self.success_angle_max < self.success_angle:
            raise ValueError(
                f"no rotation is a success: success_angle {self.success_angle} is larger than "
                f"success_angle_max {self.success_angle_max} rad"
            )
        if self.success_return == 0.0 and self.success_angle == 0.0:
            raise ValueError("a success needs a success_return or a success_angle")
        return self


# Corrected in hindsight; all presets but `paper` share its settings.
_HINDSIGHT: Mapping[str, Any] = {
    "variant": "planar",
    "noise": {"stiffness": 0.16, "attractor": 0.016, "rotation": 0.05, "catch_shift": 0.016},
    "learner": {"name": "power", "sigma": 6, "weights": "sharpened", "decay": 0.97},
    "ret": "landing",
    "budget": 60,
    "mean_every": 5,
    "landing_gain": 0.7,
    "level_gain": 0.7,
    "turn_gain": 0.5,
    "vigour_gain": 0.3,
    "tempo_gain": 0.3,
    "success_return": 0.0,
    "success_angle": math.radians(TRUE_TURN[0]),
    "success_angle_max": math.radians(TRUE_TURN[1]),
    "confirm": 29,  # a success rate of 0.9
    "retests": 10,
}
_GAINS = ("landing_gain", "level_gain", "turn_gain", "vigour_gain", "tempo_gain")
PRESETS: Mapping[str, Mapping[str, Any]] = {
    # Plans on a model of the toss, and falls back on the learner of `hindsight`.
    "model_based": {**_HINDSIGHT, "learner": {"name": "model_based"}},
    "hindsight": _HINDSIGHT,
    # For comparison: what the returns, or the corrections, reach alone.
    "return_only": {**_HINDSIGHT, **dict.fromkeys(_GAINS, 0.0)},
    "corrections_only": {
        **_HINDSIGHT,
        "learner": {"name": "corrections_only"},
        "mean_every": 1,
    },
    "paper": {
        "variant": "full",
        "noise": {"stiffness": 0.1, "attractor": 0.01, "rotation": 0.05, "catch_shift": 0.01},
        "learner": {"name": "power", "sigma": 6, "weights": "return", "decay": 1.0},
        "ret": "eq5",
        "budget": 50,
        "mean_every": 0,
        "landing_gain": 0.0,
        "success_return": 0.9,
        "success_angle": 0.0,
        "confirm": 3,
        "retests": 10,
    },
}
