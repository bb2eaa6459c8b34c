# SPDX-License-Identifier: Apache-2.0
"""Bayesian optimisation of the return [Brochu2010], along the directions of an error model.

A baseline: of the model it uses the directions alone, and of a rollout the return alone.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtr

from wam_power_ros.learning.learner import ErrorModel, GaussianLearner, LearnerSettings

LENGTHS = (0.25, 0.5, 1.0, 2.0)  # of the kernel, along a direction; that of the highest likelihood
NOISES = (0.05, 0.2, 0.5)  # sd of a return, relative to that of all returns
CANDIDATES = 2000


class BayesianOptimization(GaussianLearner):
    """Gaussian process of the return with a squared exponential kernel; expected improvement."""

    class Settings(LearnerSettings):
        """Settings of Bayesian optimisation.

        Attributes:
            bound: Largest coordinate along a direction, see `ErrorModel`.
        """

        bound: float = Field(default=2.0, gt=0.0, allow_inf_nan=False)

    settings: Settings
    needs_error_model = True
    _model: ErrorModel

    def __init__(
        self,
        size: int,
        settings: Settings,
        rng: np.random.Generator,
        model: ErrorModel | None = None,
    ) -> None:
        """Start at z = 0; see `LearnerClass`."""
        super().__init__(size, settings, rng, model)
        self._inverse = np.linalg.pinv(self._model.directions)

    def ask(self) -> np.ndarray:
        """The candidate of the largest expected improvement. Shape (size,)."""
        bound, d = self.settings.bound, len(self._model.directions)
        x = self._rng.uniform(-bound, bound, (CANDIDATES, d))
        if len(self._rollouts):
            best = self._mean @ self._inverse
            near = best + 0.1 * bound * self._rng.standard_normal((CANDIDATES // 2, d))
            x[: len(near)] = np.clip(near, -bound, bound)
            level, _ = self._posterior(best[np.newaxis])
            mean, sd = self._posterior(x)
            gain = (mean - level) / sd
            density = np.exp(-0.5 * gain**2) / math.sqrt(2.0 * math.pi)
            x = x[[int(np.argmax(sd * (gain * ndtr(gain) + density)))]]
        return x[0] @ self._model.directions

    def _update(self) -> None:
        self._x, returns = self._rollouts.z @ self._inverse, self._rollouts.returns
        self._level, self._scale = float(returns.mean()), max(float(returns.std()), 1e-6)
        y = (returns - self._level) / self._scale
        evidence = -math.inf
        for length in LENGTHS:
            kernel = _kernel(self._x, self._x, length)
            for noise in NOISES:
                factor = cho_factor(kernel + noise**2 * np.eye(len(y)))
                solved = cho_solve(factor, y)
                found = -0.5 * float(y @ solved) - float(np.log(np.diag(factor[0])).sum())
                if found > evidence:
                    evidence = found
                    self._factor, self._solved, self._length = factor, solved, length
        at = int(np.argmax(self._posterior(self._x)[0]))
        self._mean = self._x[at] @ self._model.directions

    def _posterior(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of the return at x (n, d). Shape (n,) each."""
        k = _kernel(x, self._x, self._length)
        variance = 1.0 - np.einsum("ij,ji->i", k, cho_solve(self._factor, k.T))
        sd = self._scale * np.sqrt(np.maximum(variance, 1e-12))
        return self._level + self._scale * (k @ self._solved), sd


def _kernel(x: np.ndarray, y: np.ndarray, length: float) -> np.ndarray:
    square = ((x[:, np.newaxis] - y) ** 2).sum(axis=2)
    return np.exp(-0.5 * square / length**2)
