# SPDX-License-Identifier: Apache-2.0
"""Episodic policy gradients: REINFORCE [Williams1992] and natural actor-critic [Peters2008].

Not in the papers: returns are divided by their standard deviation in the batch, so that one
learning rate suits any scale of returns, and the step is in units of the exploration noise.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import GaussianLearner, LearnerSettings


class _PolicyGradient(GaussianLearner):
    """A step along an estimate of the gradient of the expected return."""

    class Settings(LearnerSettings):
        """Settings of a policy gradient.

        Attributes:
            population: Number of rollouts per update.
            rate: Learning rate, in units of the exploration noise.
            decay: Factor on the exploration noise after each update.
        """

        population: int
        rate: float = Field(default=1.0, gt=0.0, allow_inf_nan=False)
        decay: float

    settings: Settings

    def _update(self) -> None:
        if len(self._rollouts) < self.settings.population:
            return
        returns = self._rollouts.returns
        deviation = float(returns.std())
        if deviation > 0.0:
            eps = (self._rollouts.z - self._mean) / self._noise  # (N, n)
            gradient = self._gradient(eps, (returns - returns.mean()) / deviation)
            self._mean = self._mean + self.settings.rate * self._noise * gradient
        self._noise *= self.settings.decay
        self._rollouts.clear()

    @abstractmethod
    def _gradient(self, eps: np.ndarray, returns: np.ndarray) -> np.ndarray:
        """Gradient in units of the noise; eps = noise * grad log pi (N, n), returns (N,)."""


class Reinforce(_PolicyGradient):
    """Episodic REINFORCE with the minimum-variance baseline [Williams1992]."""

    class Settings(_PolicyGradient.Settings):
        """Settings of REINFORCE."""

        population: int = Field(default=10, ge=2)
        decay: float = Field(default=0.95, gt=0.0, le=1.0)

    def _gradient(self, eps: np.ndarray, returns: np.ndarray) -> np.ndarray:
        # b = sum psi^2 R / sum psi^2;  grad = mean psi (R - b), per axis
        # [Peters2008, episodic REINFORCE with optimal baseline].
        square = eps**2
        baseline = (square * returns[:, np.newaxis]).sum(axis=0)
        baseline /= np.maximum(square.sum(axis=0), np.finfo(float).tiny)
        return (eps * (returns[:, np.newaxis] - baseline)).mean(axis=0)


class Enac(_PolicyGradient):
    """Episodic natural actor-critic [Peters2008]."""

    class Settings(_PolicyGradient.Settings):
        """Settings of the natural actor-critic.

        With a population below size + 1, the minimum-norm gradient that fits the returns is used.
        """

        population: int = Field(default=20, ge=2)
        decay: float = Field(default=0.9, gt=0.0, le=1.0)

    def _gradient(self, eps: np.ndarray, returns: np.ndarray) -> np.ndarray:
        # R_k = psi_k^T w + J_0 by least squares; w is the natural gradient [Peters2008, eNAC].
        design = eps - eps.mean(axis=0)
        return np.linalg.lstsq(design, returns, rcond=None)[0]
