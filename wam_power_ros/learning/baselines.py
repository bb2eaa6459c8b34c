# SPDX-License-Identifier: Apache-2.0
"""Baselines of all learners: random search, and the task's hindsight corrections alone."""

from __future__ import annotations

import numpy as np

from wam_power_ros.learning.learner import GaussianLearner


class RandomSearch(GaussianLearner):
    """The best of independent samples about z = 0."""

    def ask(self) -> np.ndarray:
        """Draw the next coordinates about z = 0. Shape (size,)."""
        return self._rng.standard_normal(self.size)

    def _update(self) -> None:
        self._mean = self._rollouts.z[int(np.argmax(self._rollouts.returns))]


class CorrectionsOnly(GaussianLearner):
    """The mean is the last rollout as corrected by the task; returns are not used.

    Without corrections every rollout reproduces the demonstration.
    """

    needs_corrections = True

    def ask(self) -> np.ndarray:
        """Return the mean, without exploration. Shape (size,)."""
        return self.mean

    def _update(self) -> None:
        self._mean = self._rollouts.z[-1]
