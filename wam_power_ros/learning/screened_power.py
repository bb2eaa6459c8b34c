# SPDX-License-Identifier: Apache-2.0
"""PoWER with model-based screening: execute the candidate with the highest predicted return."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import GaussianLearner, LearnerSettings, Model
from wam_power_ros.learning.power import power_update


class ScreenedPower(GaussianLearner):
    """PoWER with screened exploration. Not in the paper.

    Much of a skill is known before the first rollout: the path of Eq. 1 and the return of a path.
    The environment is unknown: an obstacle, how an object leaves the tool. A model predicts the
    known part and learns the rest from rollouts (`Model`). Every exploration then has three steps:

    1. Draw `candidates` samples from PoWER's distribution, the mean plus noise.
    2. Predict the return of each sample with the model.
    3. Execute the best one and learn from its measured return, not from the predicted one.

    The mean is still the weighted mean of the best rollouts (Eqs. 2-3), so a wrong model costs
    rollouts but is never mistaken for success: with a constant model this is PoWER. The noise may
    be large, because a bad candidate costs a prediction and not a rollout.

    A model predicts large differences well and small ones badly, so the number of candidates
    decreases with the number of rollouts until only PoWER refines the result.
    """

    class Settings(LearnerSettings):
        """Settings of PoWER with screening.

        Attributes:
            sigma: Size of the elite.
            decay: Factor on the exploration noise after each rollout.
            candidates: Number of candidates of the first exploration; 1: plain PoWER.
            half_life: Number of rollouts after which the number of candidates is halved, down to
                one.
        """

        sigma: int = Field(default=3, ge=1)
        decay: float = Field(default=0.965, gt=0.0, le=1.0)
        candidates: int = Field(default=200, ge=1)
        half_life: float = Field(default=16.0, gt=0.0)

    settings: Settings
    needs_model = True
    _model: Model

    def ask(self) -> np.ndarray:
        """Draw candidates; return the one with the highest predicted return. Shape (size,)."""
        halvings = len(self._rollouts) / self.settings.half_life
        count = max(1, round(self.settings.candidates * 0.5**halvings))
        candidates = self._mean + self._noise * self._rng.standard_normal((count, self.size))
        if count == 1:
            return candidates[0]
        return candidates[int(np.argmax(self._model.predict(candidates)))]

    def _update(self) -> None:
        self._model.learn(self._rollouts.z[-1], float(self._rollouts.returns[-1]))
        self._noise = self.settings.decay ** len(self._rollouts)
        z, returns = self._rollouts.elite(self.settings.sigma)
        if returns.max() > 0.0:
            self._mean = power_update(self._mean, z, returns, self.settings.sigma)
