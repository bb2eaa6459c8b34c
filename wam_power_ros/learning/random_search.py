# SPDX-License-Identifier: Apache-2.0
"""Random search, the baseline that a learner has to exceed."""

from __future__ import annotations

import numpy as np

from wam_power_ros.learning.learner import LearnerSettings, Model, Rollouts, check_start


class RandomSearch:
    """The best of independent samples about z = 0."""

    class Settings(LearnerSettings):
        """Settings of random search: none."""

    needs_model = False

    def __init__(
        self,
        size: int,
        settings: Settings,
        rng: np.random.Generator,
        model: Model | None = None,
    ) -> None:
        """Start at z = 0; see `LearnerClass`."""
        check_start(RandomSearch, size, model)
        self.size = size
        self.settings = settings
        self._rng = rng
        self._rollouts = Rollouts(size)

    @property
    def mean(self) -> np.ndarray:
        """Coordinates of the first rollout of highest return. Shape (size,)."""
        if not len(self._rollouts):
            return np.zeros(self.size)
        return self._rollouts.z[int(np.argmax(self._rollouts.returns))]

    def ask(self) -> np.ndarray:
        """Draw the next coordinates about z = 0. Shape (size,)."""
        return self._rng.standard_normal(self.size)

    def tell(self, z: np.ndarray, ret: float) -> None:
        """Learn from a rollout; see `Learner.tell`."""
        self._rollouts.add(z, ret)
