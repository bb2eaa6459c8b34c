# SPDX-License-Identifier: Apache-2.0
"""PI2-BB, path integrals as black-box optimisation [Stulp2013]."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import (
    LearnerSettings,
    Model,
    Rollouts,
    check_start,
    weighted_mean,
)


class Pi2:
    """PI2-BB with exploration noise that decays with every update."""

    class Settings(LearnerSettings):
        """Settings of PI2-BB.

        Attributes:
            population: Number of rollouts of an update.
            eliteness: h of the weights exp(h (R - R_max) / (R_max - R_min)).
            decay: Factor on the exploration noise for each update.
        """

        population: int = Field(default=10, ge=2)
        eliteness: float = Field(default=10.0, gt=0.0, allow_inf_nan=False)
        decay: float = Field(default=0.9, gt=0.0, le=1.0)

    needs_model = False

    def __init__(
        self,
        size: int,
        settings: Settings,
        rng: np.random.Generator,
        model: Model | None = None,
    ) -> None:
        """Start at z = 0; see `LearnerClass`."""
        check_start(Pi2, size, model)
        self.size = size
        self.settings = settings
        self._rng = rng
        self._batch = Rollouts(size)
        self._noise = 1.0
        self._mean = np.zeros(size)

    @property
    def mean(self) -> np.ndarray:
        """Weighted mean of the last complete population. Shape (size,)."""
        return self._mean.copy()

    def ask(self) -> np.ndarray:
        """Draw the next coordinates, the mean plus noise. Shape (size,)."""
        return self._mean + self._noise * self._rng.standard_normal(self.size)

    def tell(self, z: np.ndarray, ret: float) -> None:
        """Learn from a rollout; see `Learner.tell`."""
        self._batch.add(z, ret)
        if len(self._batch) < self.settings.population:
            return
        returns = self._batch.returns
        spread = float(np.ptp(returns))
        if spread > 0.0:
            # P_k = exp(-h (S_k - S_min) / (S_max - S_min)) / sum, the cost S = -R;
            # theta = sum P_k theta_k [Stulp2013].
            share = (returns - returns.max()) / spread
            self._mean = weighted_mean(self._batch.z, np.exp(self.settings.eliteness * share))
        self._noise *= self.settings.decay
        self._batch.clear()
