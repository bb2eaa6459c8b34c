# SPDX-License-Identifier: Apache-2.0
"""The planner told less: without PoWER behind it, by its slopes alone; and a plain Newton step."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import ErrorModel, GaussianLearner
from wam_power_ros.learning.model_based import ModelBased

FIXED = {"predict": False, "length": 1e9}  # rollouts correct a constant, not how an error changes
SHARPENED = {"predict": False}
ALONE = {"power": False, "patience": 10**6, "planned": 10**6}


class LessInformed(ModelBased):
    """The planner, without what its settings take away.

    Without PoWER the best rollout so far is repeated where there is no better plan.
    """

    class Settings(ModelBased.Settings):
        """Settings of the planner, and what it has."""

        predict: bool = Field(default=True)  # whether it uses a prediction, if the task has one
        power: bool = Field(default=True)  # whether PoWER decides where the planner is blind

    settings: Settings

    def __init__(
        self, size: int, settings: Settings, rng: np.random.Generator, model: ErrorModel | None
    ) -> None:
        super().__init__(size, settings, rng, model)
        if not settings.predict:
            self._model.predict = None  # of this session alone

    def _planned(self) -> np.ndarray | None:
        plan = super()._planned()
        if plan is None and not self.settings.power:
            unknown = np.where(np.isnan(self._errors), math.inf, np.abs(self._errors))
            plan = self._z[np.argmin(unknown.max(axis=1))] if len(self._z) else np.zeros(self.size)
        return plan

    def _was_run(self, z: np.ndarray) -> bool:
        return self.settings.power and super()._was_run(z)


class Newton(GaussianLearner):
    """From the latest rollout the whole step that the rough slopes say, its known parts alone."""

    needs_error_model = True
    _next: np.ndarray | None = None

    def ask(self) -> np.ndarray:
        """Return the mean, without exploration. Shape (size,)."""
        return self.mean

    def measure(self, z: np.ndarray, error: np.ndarray) -> None:
        """See `MeasuringLearner`; no parameter changes by more than its step."""
        self._next = sum(self._model.correction(error, 1.0), z)

    def trust_returns(self) -> None:
        """See `MeasuringLearner`: there is nothing else to learn from."""

    def _update(self) -> None:
        """Take the step; after a rollout without an error stay there."""
        told = self._rollouts.z[-1] if self._next is None else self._next
        self._mean, self._next = told, None
