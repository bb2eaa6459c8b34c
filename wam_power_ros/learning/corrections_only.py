# SPDX-License-Identifier: Apache-2.0
"""Hindsight corrections only: the baseline for a task that has them."""

from __future__ import annotations

import numpy as np

from wam_power_ros.learning.learner import GaussianLearner


class CorrectionsOnly(GaussianLearner):
    """The mean is the last rollout as corrected by the task; returns are not used.

    Without corrections every rollout reproduces the demonstration.
    """

    def ask(self) -> np.ndarray:
        """Return the mean, without exploration. Shape (size,)."""
        return self.mean

    def _update(self) -> None:
        self._mean = self._rollouts.z[-1]
