# SPDX-License-Identifier: Apache-2.0
"""Learners that the studies compare with, beside those that are installed.

A session finds them by their classes, see `installed.find`; studies name them as in `RIVALS`.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import (
    GaussianLearner,
    LearnerSettings,
    weighted_mean,
)

RIVALS = {  # name in a study -> name for a session
    "random": f"{__name__}:RandomSearch",
    "pi2_bb": f"{__name__}:Pi2",
}


class RandomSearch(GaussianLearner):
    """The best of independent samples about z = 0."""

    def ask(self) -> np.ndarray:
        """Draw the next coordinates about z = 0. Shape (size,)."""
        return self._rng.standard_normal(self.size)

    def _update(self) -> None:
        self._mean = self._rollouts.z[int(np.argmax(self._rollouts.returns))]


class Pi2(GaussianLearner):
    """PI2-BB, path integrals as black-box optimisation [Stulp2013]; the noise decays."""

    class Settings(LearnerSettings):
        """Settings of PI2-BB."""

        population: int = Field(default=10, ge=2)  # rollouts per update
        # h of the weights exp(h (R - R_max) / (R_max - R_min))
        eliteness: float = Field(default=10.0, gt=0.0, allow_inf_nan=False)
        decay: float = Field(default=0.9, gt=0.0, le=1.0)  # of the noise after each update

    settings: Settings

    def _update(self) -> None:
        if len(self._rollouts) < self.settings.population:
            return
        z, returns = self._rollouts.z, self._rollouts.returns
        if (spread := float(np.ptp(returns))) > 0.0:
            # P_k = exp(-h (S_k - S_min) / (S_max - S_min)) / sum, with the cost S = -R;
            # theta = sum P_k theta_k [Stulp2013].
            share = (returns - returns.max()) / spread
            self._mean = weighted_mean(z, np.exp(self.settings.eliteness * share))
        self._noise *= self.settings.decay
        self._rollouts.clear()
