# SPDX-License-Identifier: Apache-2.0
"""PoWER that thinks before it tries: many candidates are drawn, the most promising one is tried."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from wam_power_ros.learning.power import power_update


class Model(Protocol):
    """A prediction of returns that is there before any rollout, and may learn from each.

    Both methods are functions of what was learnt before, in its order: no generator, no clock.
    """

    def predict(self, z: np.ndarray) -> np.ndarray:
        """Returns to expect at candidates z (B, size). Shape (B,)."""
        ...

    def learn(self, z: np.ndarray, ret: float) -> None:
        """Take in that z (size,) returned `ret`."""
        ...


class Screened(BaseModel):
    """PoWER with screened exploration; ours.

    Much of a skill is known before anything is tried: where Eq. 1 leads, and what a return asks
    for. What is not known is the world: an obstacle, how a pancake leaves the pan. A model says
    what it can say and learns the rest from the rollouts (`Model`). Each exploration then is:

    1. Draw `candidates` points from PoWER's own distribution, the mean plus noise.
    2. Ask the model what each would return.
    3. Try the one that promises most. The rollout's return, not the promise, is learnt from.

    The mean stays PoWER's weighted mean of the best rollouts (Eqs. 2-3), so a wrong model costs
    rollouts but cannot pass for success: with a model that says nothing this is PoWER itself.
    The noise may be wide, for bad candidates cost a prediction and not a rollout.

    A model is right about the large and wrong about the small: the more has been tried, the fewer
    candidates are drawn. In the end it is PoWER alone that refines what the model led to.

    Attributes:
        sigma: size of the elite.
        decay: factor on the exploration for each rollout told.
        candidates: drawn for the first exploration; 1 is PoWER.
        half_life: rollouts told after which half as many are drawn, never fewer than one.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["screened"] = "screened"
    sigma: int = Field(default=3, ge=1)
    decay: float = Field(default=0.965, gt=0.0, le=1.0)
    candidates: int = Field(default=200, ge=1)
    half_life: float = Field(default=16.0, gt=0.0)


class ScreenedPower:
    """The method of `Screened`, behind `learners.Search`."""

    def __init__(self, size: int, settings: Screened, model: Model) -> None:
        """Start at z = 0; `model` is told every rollout."""
        self._settings = settings
        self._model = model
        self._told: list[np.ndarray] = []
        self._returns: list[float] = []
        self.mean = np.zeros(size)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """The most promising of the candidates, the first of equals. Shape (size,)."""
        told = len(self._told)
        noise = self._settings.decay**told
        count = max(1, round(self._settings.candidates * 0.5 ** (told / self._settings.half_life)))
        candidates = self.mean + noise * rng.standard_normal((count, len(self.mean)))
        if len(candidates) == 1:
            return candidates[0]
        return candidates[int(np.argmax(self._model.predict(candidates)))]

    def learn(self, z: np.ndarray, ret: float) -> None:
        """Tell the model, and move the mean."""
        self._model.learn(z, ret)
        self._told.append(z)
        self._returns.append(ret)
        if max(self._returns) > 0.0:
            self.mean = power_update(  # [Kormushev2010, (2)-(3)]
                self.mean, np.stack(self._told), np.array(self._returns), self._settings.sigma
            )
