# SPDX-License-Identifier: Apache-2.0
"""Settings that a task has if it states none: of the skill, and of the fit of its policies."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from wam_power_ros.learning.dmp import FitSettings
from wam_power_ros.learning.parametrization import NoiseScales

FIT = FitSettings(count=8, width=0.5, k_min=150.0, k_max=500.0, damping=32.0, error=1e-3)


class TaskSettings(BaseModel):
    """Settings of a task; one with further settings derives its own from them."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Learnt parameters, see `parametrization_of`
    variant: Literal["full", "diagonal", "symmetric", "attractors"] = "full"
    # Of the exploration
    noise: NoiseScales = NoiseScales(stiffness=0.1, attractor=0.01, rotation=0.05)
    settle_time: float = Field(default=1.0, ge=0.0, le=10.0)  # after the movement [s]
