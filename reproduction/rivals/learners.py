# SPDX-License-Identifier: Apache-2.0
"""Learners that the studies compare with, beside those that are installed.

A session finds them by their classes, see `installed.find`; studies name them as in `RIVALS`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Protocol

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
from wam_power_ros.learning.power import SIGMA_DEFAULT, Power, power_update

RIVALS = {  # name in a study -> name for a session
    name: f"{__name__}:{kind}"
    for name, kind in {
        "random": "RandomSearch",
        "auto_power": "AutoPower",
        "adaptive_power": "AdaptivePower",
        "pi2_bb": "Pi2",
        "reinforce": "Reinforce",
        "enac": "Enac",
        "screened": "ScreenedPower",
        "bayesian_optimization": "BayesianOptimization",
    }.items()
}
SIGMAS = (2, 3, 4, 6, 8, 12, 16, 24)  # elite sizes that `choose_sigma` chooses from
ROLLOUTS_MIN = 8  # smallest number of rollouts with which `choose_sigma` chooses
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


def choose_sigma(rollouts: np.ndarray, returns: np.ndarray) -> int:
    """Choose the elite size with the largest expected gain, by leave-one-out. Not in the paper.

    For each size s, and each rollout k left out in turn, m is the return-weighted mean of the s
    best of the others and c the unweighted mean of the others:

        d_k = m - c,    p_k = (theta_k - c) . d_k / |d_k|,
        gain(s) = mean_k |d_k| cov_k(p, R) / var_k(p),

    the length of the step from the centre of the rollouts to the mean of the elite, times the slope
    of the return along that step at the rollouts left out. A small elite makes a large step, which
    is uphill without noise in the returns. If its returns are high by chance, the rollouts left out
    show a small slope, and a larger elite, which averages the noise, is chosen.

    Args:
        rollouts: Parameters of the past rollouts, oldest first. Shape (m, n).
        returns: Returns of the past rollouts, >= 0. Shape (m,).

    Returns:
        The size in `SIGMAS` with the largest gain, the smaller one of equals; SIGMA_DEFAULT with
        fewer than ROLLOUTS_MIN rollouts or if no gain is positive.
    """
    count = len(returns)
    if count < ROLLOUTS_MIN:
        return SIGMA_DEFAULT
    order = best_first(returns)
    rollouts, returns = rollouts[order], returns[order]
    sums = np.cumsum(returns[:, np.newaxis] * rollouts, axis=0)  # sums over the best 1, 2, ...
    weights = np.cumsum(returns)
    centre = (rollouts.sum(axis=0) - rollouts) / (count - 1)  # (m, n), mean of all but k
    best, chosen = 0.0, SIGMA_DEFAULT
    for size in SIGMAS:
        if size >= count - 1:
            break
        inside = np.arange(count) < size  # if k is in the elite, the next best replaces it
        total = np.where(inside, weights[size] - returns, weights[size - 1])
        if not (total > 0.0).all():
            continue
        own = returns[:, np.newaxis] * rollouts
        step = np.where(inside[:, np.newaxis], sums[size] - own, sums[size - 1])
        step = step / total[:, np.newaxis] - centre  # d_k, (m, n)
        length = np.sqrt((step**2).sum(axis=1))
        if not (length > 0.0).all():
            continue
        along = ((rollouts - centre) * step).sum(axis=1) / length  # p_k
        spread = along - along.mean()
        if not (variance := float((spread**2).mean())) > 0.0:
            continue
        gain = float(length.mean()) * float((spread * (returns - returns.mean())).mean()) / variance
        if gain > best:
            best, chosen = gain, size
    return chosen


class AutoPower(Power):
    """PoWER whose elite has the size that `choose_sigma` chooses after every rollout."""

    @property
    def sigma(self) -> int:
        """Size of the elite of the present rollouts."""
        return choose_sigma(self._rollouts.z, self._rollouts.returns)


class AdaptivePower(GaussianLearner):
    """PoWER with one exploration variance per parameter, from the elite, as in [Kober2009]."""

    class Settings(LearnerSettings):
        """Settings of adaptive PoWER.

        Attributes:
            sigma: Size of the elite for the mean.
            variance_sigma: Size of the elite for the variance; larger, so that the variance does
                not collapse.
            smallest: Lower bound of the variances, as a fraction of the initial one.
            largest: Upper bound of the variances, as a multiple of the initial one.
        """

        sigma: int = Field(default=10, ge=1)
        variance_sigma: int = Field(default=100, ge=1)
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


class _Batches(GaussianLearner):
    """Learns from `population` rollouts at once, and explores less after each."""

    class Settings(LearnerSettings):
        """Settings of a learner from batches.

        Attributes:
            population: Number of rollouts per update.
            decay: Factor on the exploration noise after each update.
        """

        population: int
        decay: float

    settings: Settings

    def _update(self) -> None:
        if len(self._rollouts) < self.settings.population:
            return
        self._improve(self._rollouts.z, self._rollouts.returns)
        self._noise *= self.settings.decay
        self._rollouts.clear()

    @abstractmethod
    def _improve(self, z: np.ndarray, returns: np.ndarray) -> None:
        """Move the mean by rollouts z (N, n) and their returns (N,)."""


class Pi2(_Batches):
    """PI2-BB, path integrals as black-box optimisation [Stulp2013]; the noise decays."""

    class Settings(_Batches.Settings):
        """Settings of PI2-BB.

        Attributes:
            eliteness: h of the weights exp(h (R - R_max) / (R_max - R_min)).
        """

        population: int = Field(default=10, ge=2)
        eliteness: float = Field(default=10.0, gt=0.0, allow_inf_nan=False)
        decay: float = Field(default=0.9, gt=0.0, le=1.0)

    settings: Settings

    def _improve(self, z: np.ndarray, returns: np.ndarray) -> None:
        spread = float(np.ptp(returns))
        if spread > 0.0:
            # P_k = exp(-h (S_k - S_min) / (S_max - S_min)) / sum, with the cost S = -R;
            # theta = sum P_k theta_k [Stulp2013].
            share = (returns - returns.max()) / spread
            self._mean = weighted_mean(z, np.exp(self.settings.eliteness * share))


class _PolicyGradient(_Batches):
    """A step along an estimate of the gradient of the expected return.

    Not in the papers: returns are divided by their standard deviation in the batch, so that one
    learning rate suits any scale of returns, and the step is in units of the exploration noise.
    """

    class Settings(_Batches.Settings):
        """Settings of a policy gradient.

        Attributes:
            rate: Learning rate, in units of the exploration noise.
        """

        rate: float = Field(default=1.0, gt=0.0, allow_inf_nan=False)

    settings: Settings

    def _improve(self, z: np.ndarray, returns: np.ndarray) -> None:
        deviation = float(returns.std())
        if deviation > 0.0:
            eps = (z - self._mean) / self._noise  # (N, n)
            gradient = self._gradient(eps, (returns - returns.mean()) / deviation)
            self._mean = self._mean + self.settings.rate * self._noise * gradient

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


class Model(Protocol):
    """A predictor of returns, usable before the first rollout, that may learn from every rollout.

    Both methods depend only on the rollouts learnt from and their order: no generator, no clock.
    """

    def predict(self, z: np.ndarray) -> np.ndarray:
        """Predict the returns of candidates z (B, size). Shape (B,)."""

    def learn(self, z: np.ndarray, ret: float) -> None:
        """Learn from a rollout at z (size,) with return `ret`."""


class ScreenedPower(GaussianLearner):
    """PoWER with screened exploration: executes the candidate of highest predicted return.

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

    def __init__(
        self, size: int, settings: Settings, rng: np.random.Generator, model: Model
    ) -> None:
        """Start at z = 0; see `LearnerClass`. The model predicts returns, not errors."""
        super().__init__(size, settings, rng)
        self._returns = model

    def ask(self) -> np.ndarray:
        """Draw candidates; return the one with the highest predicted return. Shape (size,)."""
        halvings = len(self._rollouts) / self.settings.half_life
        count = max(1, round(self.settings.candidates * 0.5**halvings))
        candidates = self._mean + self._noise * self._rng.standard_normal((count, self.size))
        if count == 1:
            return candidates[0]
        return candidates[int(np.argmax(self._returns.predict(candidates)))]

    def _update(self) -> None:
        self._returns.learn(self._rollouts.z[-1], float(self._rollouts.returns[-1]))
        self._noise = self.settings.decay ** len(self._rollouts)
        z, returns = self._rollouts.elite(self.settings.sigma)
        if returns.max() > 0.0:
            self._mean = power_update(self._mean, z, returns, self.settings.sigma)


class BayesianOptimization(GaussianLearner):
    """Gaussian process of the return, squared exponential kernel, expected improvement.

    [Brochu2010], along the directions of an error model: of that it uses the directions alone, and
    of a rollout the return alone.
    """

    class Settings(LearnerSettings):
        """Settings of Bayesian optimisation.

        Attributes:
            bound: Largest coordinate along a direction, see `ErrorModel`.
        """

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
