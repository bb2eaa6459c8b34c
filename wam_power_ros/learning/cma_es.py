# SPDX-License-Identifier: Apache-2.0
"""CMA-ES of the `cmaes` library [Hansen2016]."""

from __future__ import annotations

import cmaes
import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import LearnerSettings, Model, Rollouts, check_start


class CmaEs:
    """CMA-ES, started with unit step size."""

    class Settings(LearnerSettings):
        """Settings of CMA-ES.

        Attributes:
            population: Number of rollouts of a generation; if omitted, the library's
                4 + 3 ln(size).
        """

        population: int | None = Field(default=None, ge=5)

    needs_model = False

    def __init__(
        self,
        size: int,
        settings: Settings,
        rng: np.random.Generator,
        model: Model | None = None,
    ) -> None:
        """Start at z = 0, with two parameters at least; see `LearnerClass`."""
        check_start(CmaEs, size, model, size_min=2)
        self.size = size
        self.settings = settings
        self._rng = rng
        self._batch = Rollouts(size)
        self._optimizer = cmaes.CMA(
            mean=np.zeros(size), sigma=1.0, seed=0, population_size=settings.population
        )

    @property
    def mean(self) -> np.ndarray:
        """Mean of the search distribution. Shape (size,)."""
        return self._optimizer.mean.copy()

    def ask(self) -> np.ndarray:
        """Draw the next coordinates from the search distribution. Shape (size,)."""
        # The library draws from a generator of its own, so that one is seeded before every draw.
        self._optimizer.reseed_rng(int(self._rng.integers(2**32)))
        return self._optimizer.ask()

    def tell(self, z: np.ndarray, ret: float) -> None:
        """Learn from a rollout; see `Learner.tell`."""
        self._batch.add(z, ret)
        if len(self._batch) == self._optimizer.population_size:
            costs = (-self._batch.returns).tolist()  # the library minimises
            self._optimizer.tell(list(zip(self._batch.z, costs, strict=True)))
            self._batch.clear()
