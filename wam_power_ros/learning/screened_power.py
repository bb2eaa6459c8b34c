# SPDX-License-Identifier: Apache-2.0
"""PoWER with model-based screening: of many candidates, the one of highest predicted return."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import GaussianLearner, LearnerSettings, Model
from wam_power_ros.learning.power import power_update


class ScreenedPower(GaussianLearner):
    """PoWER with screened exploration; ours.

    Much of a skill is known before the first rollout: the path of Eq. 1 and the return of a path.
    Unknown is the world: an obstacle, how a pancake leaves the pan. A model predicts what it can
    and learns the rest from the rollouts (`Model`). Each exploration then is:

    1. Draw `candidates` points from PoWER's own distribution, the mean plus noise.
    2. Predict the return of each with the model.
    3. Execute the best one. The measured return is learnt from, not the predicted one.

    The mean stays PoWER's weighted mean of the best rollouts (Eqs. 2-3), so a wrong model costs
    rollouts but cannot pass for success: with a constant model this is PoWER itself. The noise
    may be wide, for a bad candidate costs a prediction and not a rollout.

    A model is right about large differences and wrong about small ones: the number of candidates
    decreases with the number of rollouts, until PoWER alone refines the result.
    """

    class Settings(LearnerSettings):
        """Settings of PoWER with screening.

        Attributes:
            sigma: Size of the elite.
            decay: Factor on the exploration noise for each rollout.
            candidates: Number of candidates of the first exploration; 1: plain PoWER.
            half_life: Number of rollouts after which the number of candidates is halved; it never
                falls below one.
        """

        sigma: int = Field(default=3, ge=1)
        decay: float = Field(default=0.965, gt=0.0, le=1.0)
        candidates: int = Field(default=200, ge=1)
        half_life: float = Field(default=16.0, gt=0.0)

    settings: Settings
    needs_model = True

    def __init__(
        self,
        size: int,
        settings: Settings,
        rng: np.random.Generator,
        model: Model | None = None,
    ) -> None:
        """Start at z = 0 with a model that has learnt nothing; see `LearnerClass`."""
        super().__init__(size, settings, rng, model)
        if model is None:
            raise ValueError("ScreenedPower needs a model of the returns")
        self._model = model

    def ask(self) -> np.ndarray:
        """Draw candidates; return the first one of highest predicted return. Shape (size,)."""
        halvings = len(self._rollouts) / self.settings.half_life
        count = max(1, round(self.settings.candidates * 0.5**halvings))
        candidates = self._mean + self._noise * self._rng.standard_normal((count, self.size))
        if count == 1:
            return candidates[0]
        return candidates[int(np.argmax(self._model.predict(candidates)))]

    def _update(self) -> None:
        rollouts, returns = self._rollouts.z, self._rollouts.returns
        self._model.learn(rollouts[-1], float(returns[-1]))
        self._noise = self.settings.decay ** len(returns)
        if returns.max() > 0.0:
            self._mean = power_update(self._mean, rollouts, returns, self.settings.sigma)
