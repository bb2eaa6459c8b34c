# SPDX-License-Identifier: Apache-2.0
"""The task's corrections alone, as a baseline of the learners."""

from __future__ import annotations

import numpy as np

from wam_power_ros.learning.learner import GaussianLearner


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
