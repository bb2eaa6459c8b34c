# SPDX-License-Identifier: Apache-2.0
"""Settings of a session, and the two sets of them that are used."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from wam_power_ros.learning.power import Power
from wam_power_ros.tasks.flip.parametrization import FlipNoise
from wam_power_ros.tasks.flip.returns import LandingWeights, PancakeWeights


class PracticeSettings(BaseModel):
    """Settings of a session; `preset` has the two sets that are used.

    Attributes:
        variant: what of the policy is learnt, see `flip_parametrization`.
        noise: one standard deviation of exploration a group.
        power: settings of the learner.
        ret: return that is learnt from: "eq5" (the paper's Eq. 5) or "landing" (`landing_return`).
        pancake_weights: of Eq. 5.
        landing_weights: of `landing_return`.
        choice: rule that chooses the demonstration, see `choose_demonstration`.
        budget: number of usable rollouts, reproductions included and re-tests not.
        mean_every: every n-th trial of the practice runs the mean; 0: only to confirm a success.
        landing_gain: part of a measured landing error by which a trial's catch shift is moved
            before it is learnt from; 0: none. Needs the variant "planar".
        landing_limit: most the catch shift is moved for one trial [m].
        turn_gain: part of what a trial's rotation lacked of half a turn by which its flick is moved
            before it is learnt from; 0: none. Needs the variant "planar".
        turn_limit: most the flick is moved for one trial [1].
        success_return: return from which a trial is a success; 0: the return does not matter.
        success_angle: rotation in the air from which a trial is a success if it was also caught
            and flipped [rad]; 0: the flip does not matter.
        confirm: runs of one mean that must succeed in a row for the session to stop; 0: never.
        confirm_margin: how much further than `success_angle` these must turn [rad]. Stopping at
            the first streak selects policies that barely succeed; the margin is against that.
        retests: runs of the final answer, not learnt from.
        attempts: how often one policy is tried when nothing can be learnt from its rollouts.
        return_noise: standard deviation of the return of one policy, for `Practice.best`.
        delta_h: height over the pan at which a falling pancake is judged [m].
        settle_time: time a rollout goes on after the movement [s].
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    variant: Literal["full", "diagonal", "symmetric", "attractors", "planar"]
    noise: FlipNoise
    power: Power.Settings
    ret: Literal["eq5", "landing"]
    pancake_weights: PancakeWeights = PancakeWeights()
    landing_weights: LandingWeights = LandingWeights()
    choice: Literal["return", "flick"]
    budget: int = Field(ge=1)
    mean_every: int = Field(ge=0)
    landing_gain: float = Field(ge=0.0, le=1.0)
    landing_limit: float = Field(default=0.25, gt=0.0, le=1.0)
    turn_gain: float = Field(default=0.0, ge=0.0, le=1.0)
    turn_limit: float = Field(default=0.1, gt=0.0, le=1.0)
    success_return: float = Field(ge=0.0, allow_inf_nan=False)
    success_angle: float = Field(ge=0.0, allow_inf_nan=False)
    confirm: int = Field(ge=0)
    confirm_margin: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    retests: int = Field(ge=0)
    attempts: int = Field(default=3, ge=1)
    return_noise: float = Field(default=0.1, ge=0.0, allow_inf_nan=False)
    delta_h: float = Field(default=0.12, gt=0.0, le=1.0)
    settle_time: float = Field(default=1.0, ge=0.0, le=10.0)

    @model_validator(mode="after")
    def _fit_together(self) -> PracticeSettings:
        if max(self.landing_gain, self.turn_gain) > 0.0 and self.variant != "planar":
            raise ValueError(
                f"landing_gain {self.landing_gain} and turn_gain {self.turn_gain} need a catch "
                f"shift and a flick: variant 'planar', not {self.variant!r}"
            )
        if self.confirm > 0 and self.success_return == 0.0 and self.success_angle == 0.0:
            raise ValueError("confirm needs a success_return or a success_angle")
        return self


_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {
        "variant": "full",
        "noise": {"stiffness": 0.1, "attractor": 0.01, "rotation": 0.05, "catch_shift": 0.01},
        "power": {"sigma": 6, "weights": "return", "decay": 1.0},
        "ret": "eq5",
        "choice": "return",
        "budget": 50,
        "mean_every": 0,
        "landing_gain": 0.0,
        "success_return": 0.9,
        "success_angle": 0.0,
        "confirm": 3,
        "retests": 10,
    },
    "flip": {
        "variant": "planar",
        "noise": {"stiffness": 0.16, "attractor": 0.016, "rotation": 0.05, "catch_shift": 0.016},
        "power": {"sigma": 6, "weights": "sharpened", "sharpness": 0.3, "decay": 0.97},
        "ret": "landing",
        "choice": "return",
        "budget": 60,
        "mean_every": 5,
        "landing_gain": 0.7,
        "turn_gain": 0.5,
        "success_return": 0.0,
        "success_angle": math.radians(150.0),
        "confirm": 8,
        "confirm_margin": math.radians(10.0),
        "retests": 10,
    },
}


def preset(name: str, **changes: Any) -> PracticeSettings:  # noqa: ANN401 - checked by the model
    """Settings of a session by name, with some of them changed.

    Args:
        name: "paper" (Eq. 5, full matrices, sigma 6, no decay, stop at R >= .9 reproducibly) or
            "flip" (ours: planar, sharpened weights, landing correction, a true and caught flip).
        **changes: fields of `PracticeSettings`; a mapping for `noise` or `power` changes only the
            fields it names.

    Raises:
        ValueError: unknown name, unknown field or a value out of range.
    """
    if name not in _PRESETS:
        raise ValueError(f"preset {name!r} is not one of {', '.join(_PRESETS)}")
    values = dict(_PRESETS[name])
    for key, value in changes.items():
        if key in ("noise", "power") and isinstance(value, Mapping):
            value = {**values[key], **value}
        values[key] = value
    return PracticeSettings.model_validate(values)
