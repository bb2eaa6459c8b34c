# SPDX-License-Identifier: Apache-2.0
"""Settings of ball-in-a-cup, and its presets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from wam_power_ros.learning.demonstration import Movement
from wam_power_ros.learning.dmp import FitSettings
from wam_power_ros.learning.parametrization import NoiseScales

# A swing of 2.2 s with accelerations of 9 m/s^2, which alternate every 0.3 s. Stiff: friction and
# torque constants scatter the landings of one policy by 0.5 to 0.8 cm (standard deviation), with
# half the stiffness by twice that.
CUP_FIT = FitSettings(
    count=16,
    width=0.6,
    k_min=800.0,
    k_max=2000.0,
    damping=80.0,
    movement=Movement(start=0.05, end=0.05),
)


class CupNoise(NoiseScales):
    """Standard deviation of the exploration noise of a swing."""

    amplitude: float = Field(default=0.01, gt=0.0, le=1.0)  # [1]
    sideways: float = Field(default=0.005, gt=0.0, le=1.0)  # [m]


class CupSettings(BaseModel):
    """Settings of the task."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Learnt parameters, see `task.BallInCup.parametrization`
    variant: Literal["swing", "attractors", "full", "diagonal", "symmetric"]
    noise: CupNoise  # of the exploration
    # alpha of the return exp(-alpha d^2) [1/m^2]; 100 in [Kober2011]
    sharpness: float = Field(gt=0.0, le=1000.0)
    # Fraction of the miss for which a rollout is corrected in hindsight; needs "swing"
    gain: float = Field(default=0.0, ge=0.0, le=1.0)
    # Largest d of a success, whose ball also ends in the cup [m]
    success_distance: float = Field(default=0.03, gt=0.0, le=1.0)
    settle_time: float = Field(default=1.0, ge=0.0, le=10.0)  # after the movement [s]


_COMMON: Mapping[str, Any] = {
    "noise": {"stiffness": 0.1, "attractor": 0.003, "rotation": 0.03},
    "sharpness": 100.0,
    "learner": {"name": "power", "sigma": 6, "weights": "sharpened", "decay": 0.97},
    "budget": 75,
    "mean_every": 3,
    "confirm": 29,  # a success rate of 0.9
    "retests": 10,
}
_CUP: Mapping[str, Any] = {**_COMMON, "variant": "swing", "gain": 0.5}
PRESETS: Mapping[str, Mapping[str, Any]] = {
    # Plans by the rough slopes of the miss, and falls back on the learner of `cup`.
    "model_based": {**_CUP, "learner": {"name": "model_based"}},
    "cup": _CUP,
    # For comparison: what the return, or the corrections, reach alone. Without corrections the
    # exploration must be as wide as demonstrations differ.
    "return_only": {**_CUP, "gain": 0.0, "noise": {**_COMMON["noise"], "amplitude": 0.03}},
    "corrections_only": {**_CUP, "learner": {"name": "corrections_only"}, "mean_every": 1},
    # What Kober and Peters learnt with: the return alone, and attractors alone.
    "kober": {**_COMMON, "variant": "attractors"},
}
