# SPDX-License-Identifier: Apache-2.0
"""PoWER, policy learning by weighting exploration with the returns ([Kormushev2010], Eqs. 2-3)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import (
    GaussianLearner,
    LearnerSettings,
    best_first,
    weighted_mean,
)

Weights = Literal["return", "sharpened"]
SIGMA_DEFAULT = 6  # elite size of the paper


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
        """Settings of PoWER."""

        sigma: int = Field(default=SIGMA_DEFAULT, ge=1)  # best past rollouts that are averaged
        # Their weights: "return", the returns (the paper), or "sharpened",
        # exp((R - R_max) / (sharpness (R_max - R_min))), with R_min and R_max of the elite
        weights: Weights = "return"
        sharpness: float = Field(default=0.3, gt=0.0, allow_inf_nan=False)
        # Factor on the exploration noise after each rollout; 1: constant (the paper)
        decay: float = Field(default=1.0, gt=0.0, le=1.0)

    settings: Settings

    @property
    def sigma(self) -> int:
        """Size of the elite of the present rollouts."""
        return self.settings.sigma

    def _update(self) -> None:
        self._noise = self.settings.decay ** len(self._rollouts)
        sigma = self.sigma
        z, returns = self._rollouts.elite(sigma)
        if returns.max() > 0.0:
            weights, sharpness = self.settings.weights, self.settings.sharpness
            self._mean = power_update(np.zeros(self.size), z, returns, sigma, weights, sharpness)
