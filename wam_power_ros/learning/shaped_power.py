# SPDX-License-Identifier: Apache-2.0
"""PoWER with a warm-up, rank weights and mirrored sampling. Not in the paper."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import (
    GaussianLearner,
    LearnerSettings,
    best_first,
    weighted_mean,
)
from wam_power_ros.learning.power import Weights, power_update


class ShapedPower(GaussianLearner):
    """PoWER with a warm-up, rank weights and mirrored sampling."""

    class Settings(LearnerSettings):
        """Settings of shaped PoWER."""

        sigma: int = Field(default=3, ge=1)  # size of the elite
        # As in `power_update`, or "rank": w_i = ln(sigma + 1/2) - ln(i)
        weights: Weights | Literal["rank"] = "rank"
        decay: float = Field(default=0.965, gt=0.0, le=1.0)  # of the noise, beyond the warm-up
        warm_up: int = Field(default=10, ge=0)  # rollouts during which the mean stays at z = 0
        # Whether every second sample mirrors its predecessor about the mean at which that was drawn
        mirrored: bool = True

    settings: Settings
    _centre: np.ndarray  # mean about which the current pair is sampled

    def ask(self) -> np.ndarray:
        """Draw the next coordinates, or mirror the last rollout. Shape (size,)."""
        if self.settings.mirrored and len(self._rollouts) % 2 == 1:
            return 2.0 * self._centre - self._rollouts.z[-1]
        return super().ask()

    def _update(self) -> None:
        count, settings = len(self._rollouts), self.settings
        if count % 2 == 1:
            self._centre = self._mean
        self._noise = settings.decay ** max(count - settings.warm_up, 0)
        z, returns = self._rollouts.elite(settings.sigma)
        if count < settings.warm_up or returns.max() <= 0.0:
            return
        if settings.weights == "rank":
            rank = np.arange(1, len(z) + 1)
            by_rank = np.log(settings.sigma + 0.5) - np.log(rank)  # [Hansen2016, (49)]
            self._mean = weighted_mean(z[best_first(returns)], by_rank)
        else:
            self._mean = power_update(self._mean, z, returns, settings.sigma, settings.weights)
