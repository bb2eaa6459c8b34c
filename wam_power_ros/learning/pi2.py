# SPDX-License-Identifier: Apache-2.0
"""PI2-BB, path integrals as black-box optimisation [Stulp2013]."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import GaussianLearner, LearnerSettings, weighted_mean


class Pi2(GaussianLearner):
    """PI2-BB with exploration noise that decays with every update."""

    class Settings(LearnerSettings):
        """Settings of PI2-BB.

        Attributes:
            population: Number of rollouts per update.
            eliteness: h of the weights exp(h (R - R_max) / (R_max - R_min)).
            decay: Factor on the exploration noise after each update.
        """

        population: int = Field(default=10, ge=2)
        eliteness: float = Field(default=10.0, gt=0.0, allow_inf_nan=False)
        decay: float = Field(default=0.9, gt=0.0, le=1.0)

    settings: Settings

    def _update(self) -> None:
        if len(self._rollouts) < self.settings.population:
            return
        returns = self._rollouts.returns
        spread = float(np.ptp(returns))
        if spread > 0.0:
            # P_k = exp(-h (S_k - S_min) / (S_max - S_min)) / sum, with the cost S = -R;
            # theta = sum P_k theta_k [Stulp2013].
            share = (returns - returns.max()) / spread
            self._mean = weighted_mean(self._rollouts.z, np.exp(self.settings.eliteness * share))
        self._noise *= self.settings.decay
        self._rollouts.clear()
