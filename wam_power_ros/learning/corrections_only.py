# SPDX-License-Identifier: Apache-2.0
"""Hindsight corrections without a learner, the baseline of a task that has them."""

from __future__ import annotations

import numpy as np

from wam_power_ros.learning.learner import GaussianLearner, LearnerSettings


class CorrectionsOnly(GaussianLearner):
    """The last rollout, at the coordinates to which the task corrected it: no return is used.

    Without corrections it repeats the reproduction of the demonstration.
    """

    class Settings(LearnerSettings):
        """Settings of the baseline: none."""

    settings: Settings

    def ask(self) -> np.ndarray:
        """The mean: it never explores. Shape (size,)."""
        return self.mean

    def _update(self) -> None:
        self._mean = self._rollouts.z[-1]
