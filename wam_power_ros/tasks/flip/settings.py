# SPDX-License-Identifier: Apache-2.0
"""Settings of flipping a pancake, and its presets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from wam_power_ros.learning.demonstration import Movement
from wam_power_ros.learning.dmp import FitSettings
from wam_power_ros.tasks.flip.parametrization import FlipNoise

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
    """Settings of the task."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Learnt parameters, see `flip_parametrization`
    variant: Literal["full", "diagonal", "symmetric", "attractors", "planar"]
    noise: FlipNoise  # of the exploration
    ret: Literal["eq5", "landing"]  # return: Eq. 5, or `landing_return`
    # Fraction of the errors for which a rollout is corrected in hindsight; needs "planar"
    gain: float = Field(default=0.0, ge=0.0, le=1.0)
    success_return: float = Field(ge=0.0, allow_inf_nan=False)  # smallest of a success
    # Rotation in flight of a success, which must also be caught and flipped [rad]; 0: none needed
    success_angle: float = Field(ge=0.0, allow_inf_nan=False)
    success_angle_max: float = Field(default=100.0, gt=0.0, allow_inf_nan=False)
    settle_time: float = Field(default=1.0, ge=0.0, le=10.0)  # after the movement [s]

    @model_validator(mode="after")
    def _check_consistency(self) -> FlipSettings:
        if self.gain > 0.0 and self.variant != "planar":
            raise ValueError(
                f"gain {self.gain} needs parameters that only the variant 'planar' has; the "
                f"variant is {self.variant!r}"
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
    "gain": 0.7,
    "success_return": 0.0,
    "success_angle": math.radians(TRUE_TURN[0]),
    "success_angle_max": math.radians(TRUE_TURN[1]),
    "confirm": 29,  # a success rate of 0.9
    "retests": 10,
}
PRESETS: Mapping[str, Mapping[str, Any]] = {
    # Plans on a model of the toss, and falls back on the learner of `hindsight`.
    "model_based": {**_HINDSIGHT, "learner": {"name": "model_based"}},
    "hindsight": _HINDSIGHT,
    # For comparison: what the returns, or the corrections, reach alone.
    "return_only": {**_HINDSIGHT, "gain": 0.0},
    "corrections_only": {**_HINDSIGHT, "learner": {"name": "corrections_only"}, "mean_every": 1},
    "paper": {
        "variant": "full",
        "noise": {"stiffness": 0.1, "attractor": 0.01, "rotation": 0.05, "catch_shift": 0.01},
        "learner": {"name": "power", "sigma": 6, "weights": "return", "decay": 1.0},
        "ret": "eq5",
        "budget": 50,
        "mean_every": 0,
        "success_return": 0.9,
        "success_angle": 0.0,
        "confirm": 3,
        "retests": 10,
    },
}
