# SPDX-License-Identifier: Apache-2.0
"""CMA-ES of the `cmaes` library [Hansen2016]."""

from __future__ import annotations

import cmaes
import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import GaussianLearner, LearnerSettings


class CmaEs(GaussianLearner):
    """CMA-ES, started with unit step size."""

    class Settings(LearnerSettings):
        """Settings of CMA-ES."""

        # Rollouts per generation; by default as many as the library takes, 4 + 3 ln(size)
        population: int | None = Field(default=None, ge=5)

    settings: Settings
    size_min = 2

    def __init__(
        self, size: int, settings: Settings, rng: np.random.Generator, model: None = None
    ) -> None:
        """Start at z = 0; see `LearnerClass`."""
        super().__init__(size, settings, rng, model)
        self._optimizer = cmaes.CMA(
            mean=np.zeros(size), sigma=1.0, seed=0, population_size=settings.population
        )

    def ask(self) -> np.ndarray:
        """Draw the next coordinates from the search distribution. Shape (size,)."""
        # The library draws from its own generator, which is therefore seeded before every draw.
        self._optimizer.reseed_rng(int(self._rng.integers(2**32)))
        return self._optimizer.ask()

    def _update(self) -> None:
        if len(self._rollouts) == self._optimizer.population_size:
            costs = (-self._rollouts.returns).tolist()  # the library minimises
            self._optimizer.tell(list(zip(self._rollouts.z, costs, strict=True)))
            self._mean = self._optimizer.mean.copy()
            self._rollouts.clear()
