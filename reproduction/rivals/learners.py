# SPDX-License-Identifier: Apache-2.0
"""Learners that the studies compare with, beside those that are installed.

A session finds them by their classes, see `installed.find`; studies name them as in `RIVALS`.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtr

from wam_power_ros.learning.learner import (
    ErrorModel,
    GaussianLearner,
    LearnerSettings,
    best_first,
    weighted_mean,
)
from wam_power_ros.learning.power import power_update

RIVALS = {  # name in a study -> name for a session
    name: f"{__name__}:{kind}"
    for name, kind in {
        "random": "RandomSearch",
        "adaptive_power": "AdaptivePower",
        "pi2_bb": "Pi2",
        "bayesian_optimization": "BayesianOptimization",
    }.items()
}
# Of Bayesian optimisation
LENGTHS = (0.25, 0.5, 1.0, 2.0)  # of the kernel, along a direction; that of the highest likelihood
NOISES = (0.05, 0.2, 0.5)  # sd of a return, relative to that of all returns
CANDIDATES = 2000


class RandomSearch(GaussianLearner):
    """The best of independent samples about z = 0."""

    def ask(self) -> np.ndarray:
        """Draw the next coordinates about z = 0. Shape (size,)."""
        return self._rng.standard_normal(self.size)

    def _update(self) -> None:
        self._mean = self._rollouts.z[int(np.argmax(self._rollouts.returns))]


class AdaptivePower(GaussianLearner):
    """PoWER with one exploration variance per parameter, from the elite, as in [Kober2009]."""

    class Settings(LearnerSettings):
        """Settings of adaptive PoWER."""

        sigma: int = Field(default=10, ge=1)  # size of the elite for the mean
        # Of the elite for the variance; larger, so that the variance does not collapse
        variance_sigma: int = Field(default=100, ge=1)
        # Bounds of the variances, relative to the initial one
        smallest: float = Field(default=0.1, gt=0.0, le=1.0)
        largest: float = Field(default=10.0, ge=1.0, allow_inf_nan=False)

    settings: Settings

    def _update(self) -> None:
        z, returns = self._rollouts.elite(self.settings.variance_sigma)
        if returns.max() <= 0.0:
            return
        order = best_first(returns)
        # sigma^2 = sum R (theta_k - theta)^2 / sum R, with the mean theta before the update.
        weights = returns[order] / returns.max()
        variance = weighted_mean((z[order] - self._mean) ** 2, weights)
        self._noise = np.sqrt(np.clip(variance, self.settings.smallest, self.settings.largest))
        sigma = self.settings.sigma
        self._mean = power_update(self._mean, *self._rollouts.elite(sigma), sigma)


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


class BayesianOptimization(GaussianLearner):
    """Gaussian process of the return, squared exponential kernel, expected improvement.

    [Brochu2010], along the directions of an error model: of that it uses the directions alone, and
    of a rollout the return alone.
    """

    class Settings(LearnerSettings):
        """Settings of Bayesian optimisation."""

        # Largest coordinate along a direction, see `ErrorModel`
        bound: float = Field(default=2.0, gt=0.0, allow_inf_nan=False)

    settings: Settings
    needs_error_model = True
    _model: ErrorModel

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

    @property
    def _inverse(self) -> np.ndarray:
        """From coordinates z to those along the directions. Shape (size, d)."""
        return np.linalg.pinv(self._model.directions)

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
