# SPDX-License-Identifier: Apache-2.0
"""Any movement, judged by a person alone: no body is tracked, and no camera is needed."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from wam_power_ros.learning.parametrization import (
    Direction,
    NoiseScales,
    Parametrization,
    Tempo,
    parametrization_of,
)
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.tasks.errors import direction
from wam_power_ros.tasks.task import (
    Assessment,
    Goal,
    LoggedRollout,
    Task,
    cut_short,
    fault_assessment,
)


class RatedNoise(NoiseScales):
    """Standard deviation of the exploration noise."""

    shift: float = Field(default=0.04, gt=0.0, le=1.0)  # of the end and the middle [m]
    tempo: float = Field(default=0.05, gt=0.0, le=1.0)  # of its logarithm [1]


class RatedSettings(BaseModel):
    """Settings of the task."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # A person's ratings are few and coarse: seven parameters, or as many as the paper
    variant: Literal["shifts", "full", "diagonal", "symmetric", "attractors"] = "shifts"
    noise: RatedNoise = RatedNoise(stiffness=0.1, attractor=0.01, rotation=0.05)
    settle_time: float = Field(default=1.0, ge=0.0, le=10.0)  # after the movement [s]


class Rated(Task):
    """A person rates each rollout.

    The rating, from 0 to 1, is the return; 1 is a success.
    """

    name: ClassVar[str] = "rated"
    rated: ClassVar[bool] = True
    Settings: ClassVar[type[RatedSettings]] = RatedSettings
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
        {
            "default": {
                "learner": {"name": "power", "sigma": 6, "weights": "sharpened", "decay": 0.97},
                "budget": 40,
                "mean_every": 4,
                "confirm": 3,  # a person is asked each time
                "retests": 0,
            }
        }
    )
    goal = Goal(achieved="was rated as it should be", first="first as it should be")

    def parametrization(self, policy: Policy) -> Parametrization:
        """Learnt parameters of a policy; see `Task`.

        The variant "shifts" has those of `errors.direction` along the axes, as many that move the
        middle of the movement and neither its begin nor its end [m], and the tempo.
        """
        variant, noise = self.settings.variant, self.settings.noise
        if variant != "shifts":
            return parametrization_of(policy, variant, noise)
        ends = [direction(policy, f"shift_{axis}", noise.shift) for axis in "xyz"]
        middle = np.sin(np.linspace(0.0, np.pi, policy.basis.count))[:, np.newaxis]
        middles = [
            Direction(noise.shift, f"middle_{axis}", middle * unit, np.zeros_like(middle * unit))
            for axis, unit in zip("xyz", np.eye(3), strict=True)
        ]
        return Parametrization(policy, [*ends, *middles, Tempo(noise.tempo)])

    def assess(self, policy: Policy, rollout: Rollout) -> Assessment:
        """Return of a rollout that a person need not rate, and no return of any other."""
        if rollout.fault is not None:
            return fault_assessment(rollout.fault)
        why = cut_short(policy, rollout, self.settle_time) or "not rated by a person"
        return Assessment(None, why=why)

    def outcome(self, record: LoggedRollout) -> str:
        """The rating; see `Task`."""
        if record.fault or record.observation is None:
            return super().outcome(record)
        return f"rated {record.observation['rating']:.2g}"


def assessed(value: float) -> Assessment:
    """Assessment of a rollout that a person has rated with a value from 0 to 1.

    Raises:
        ValueError: The value is none.
    """
    if not 0.0 <= value <= 1.0:  # nor NaN
        raise ValueError(f"a rating of {value} must be from 0 (worst) to 1 (as it should be)")
    return Assessment(value, {"rating": value}, {"rating": value}, success=value == 1.0)
