# SPDX-License-Identifier: Apache-2.0
"""PoWER that adapts the exploration variance of each parameter, as in the code of [Kober2009]."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import (
    GaussianLearner,
    LearnerSettings,
    best_first,
    weighted_mean,
)
from wam_power_ros.learning.power import power_update


class AdaptivePower(GaussianLearner):
    """PoWER with one exploration variance per parameter, estimated from the elite."""

    class Settings(LearnerSettings):
        """Settings of adaptive PoWER.

        Attributes:
            sigma: Size of the elite for the mean.
            variance_sigma: Size of the elite for the variance; larger, so that the variance does
                not collapse.
            smallest: Lower bound of the variances, as a fraction of the initial one.
            largest: Upper bound of the variances, as a multiple of the initial one.
        """

        sigma: int = Field(default=10, ge=1)
        variance_sigma: int = Field(default=100, ge=1)
        smallest: float = Field(default=0.1, gt=0.0, le=1.0)
        largest: float = Field(default=10.0, ge=1.0, allow_inf_nan=False)

    settings: Settings

    def _update(self) -> None:
        z, returns = self._rollouts.elite(self.settings.variance_sigma)
        if returns.max() <= 0.0:
            return
        order = best_first(returns)
        # sigma^2 = sum R (theta_k - theta)^2 / sum R, with the mean theta before the update.
        weights = returns[order] / returns.max()
        variance = weighted_mean((z[order] - self._mean) ** 2, weights)
        self._noise = np.sqrt(np.clip(variance, self.settings.smallest, self.settings.largest))
        sigma = self.settings.sigma
        self._mean = power_update(self._mean, *self._rollouts.elite(sigma), sigma)
