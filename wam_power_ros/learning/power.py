# SPDX-License-Identifier: Apache-2.0
"""PoWER, policy learning by weighting exploration with the returns ([Kormushev2010], Eqs. 2-3)."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import (
    GaussianLearner,
    LearnerSettings,
    best_first,
    weighted_mean,
)

Weights = Literal["return", "sharpened"]
SIGMAS = (2, 3, 4, 6, 8, 12, 16, 24)  # elite sizes that `choose_sigma` chooses from
SIGMA_DEFAULT = 6  # elite size of the paper
ROLLOUTS_MIN = 8  # smallest number of rollouts with which `choose_sigma` chooses


def power_update(
    theta: np.ndarray,
    rollouts: np.ndarray,
    returns: np.ndarray,
    sigma: int,
    weights: Weights = "return",
    sharpness: float = 0.3,
) -> np.ndarray:
    """Return-weighted mean of the explored offsets of the best rollouts [Kormushev2010, Eqs. 2-3].

        theta' = theta + sum_k (theta_k - theta) R_k / sum_k R_k,

    with k over the `sigma` rollouts of highest return among ALL past ones. theta cancels: theta' is
    the weighted mean of the elite, so the order of the rollouts does not matter. Ties at the edge
    of the elite go to the later rollouts, which were sampled closer to the current mean.

    Args:
        theta: Current parameters. Shape (n,).
        rollouts: Parameters of the past rollouts, oldest first. Shape (m, n).
        returns: Returns of the past rollouts, >= 0. Shape (m,).
        sigma: Size of the elite.
        weights: Kind of weights, see `Power.Settings`.
        sharpness: Width of the sharpened weights, see `Power.Settings`.

    Returns:
        New parameters. Shape (n,). No argument is modified.

    Raises:
        ValueError: If shapes do not match, a return is negative or not finite, or none is
            positive.
    """
    theta = np.asarray(theta, dtype=float)
    rollouts = np.asarray(rollouts, dtype=float)
    returns = np.asarray(returns, dtype=float)
    if theta.ndim != 1 or rollouts.shape != (len(returns), len(theta)) or returns.ndim != 1:
        raise ValueError(
            f"theta {theta.shape}, rollouts {rollouts.shape} and returns {returns.shape} "
            "must be (n,), (m, n) and (m,)"
        )
    if sigma < 1:
        raise ValueError(f"sigma is {sigma}, must be at least 1")
    bad = ~(np.isfinite(returns) & (returns >= 0.0))
    if bad.any():
        raise ValueError(f"returns must be finite and >= 0, got {returns[bad][:3]}")
    if not (returns > 0.0).any():
        raise ValueError(f"none of {len(returns)} returns is positive")
    elite = best_first(returns)[:sigma]
    weight = _weights(returns[elite], weights, sharpness)  # (k,)
    offsets = rollouts[elite] - theta  # (k, n)
    return theta + weighted_mean(offsets, weight)


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


def _weights(returns: np.ndarray, kind: Weights, sharpness: float) -> np.ndarray:
    """Weights of an elite, scaled to a largest weight of 1. Shape (k,)."""
    best = returns.max()
    if kind == "return":
        return returns / best
    if kind == "sharpened":
        spread = best - returns.min()
        if spread == 0.0:
            return np.ones_like(returns)
        return np.exp((returns - best) / (sharpness * spread))
    raise ValueError(f"weights {kind!r} is not one of return, sharpened")


class Power(GaussianLearner):
    """PoWER with Gaussian exploration of unit variance about the mean [Kormushev2010]."""

    class Settings(LearnerSettings):
        """Settings of PoWER.

        Attributes:
            sigma: Size of the elite, the best past rollouts whose weighted mean is taken; "auto":
                chosen by `choose_sigma` after every rollout.
            weights: Weights of the elite: "return", the returns (the paper), or "sharpened",
                exp((R - R_max) / (sharpness (R_max - R_min))), with R_min and R_max of the elite.
            sharpness: Width of the sharpened weights, in units of R_max - R_min.
            decay: Factor on the exploration noise after each rollout; 1: constant (the paper).
        """

        sigma: Annotated[int, Field(ge=1)] | Literal["auto"] = SIGMA_DEFAULT
        weights: Weights = "return"
        sharpness: float = Field(default=0.3, gt=0.0, allow_inf_nan=False)
        decay: float = Field(default=1.0, gt=0.0, le=1.0)

    settings: Settings

    @property
    def sigma(self) -> int:
        """Size of the elite of the present rollouts."""
        if self.settings.sigma != "auto":
            return self.settings.sigma
        return choose_sigma(self._rollouts.z, self._rollouts.returns)

    def _update(self) -> None:
        self._noise = self.settings.decay ** len(self._rollouts)
        sigma = self.sigma
        z, returns = self._rollouts.elite(sigma)
        if returns.max() > 0.0:
            weights, sharpness = self.settings.weights, self.settings.sharpness
            self._mean = power_update(np.zeros(self.size), z, returns, sigma, weights, sharpness)
