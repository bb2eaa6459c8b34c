# SPDX-License-Identifier: Apache-2.0
"""Write a learner and run it beside PoWER; docs/extending.md tells how a session finds yours."""

import numpy as np

from wam_power_ros.learning.learner import GaussianLearner, LearnerSettings, best_first
from wam_power_ros.learning.power import Power


class Elite(GaussianLearner):
    """The mean of the best rollouts so far, all with the same weight."""

    class Settings(LearnerSettings):
        """Number of rollouts that are kept."""

        keep: int = 5

    settings: Settings

    def _update(self) -> None:
        best = best_first(self._rollouts.returns)[: self.settings.keep]
        self._mean = self._rollouts.z[best].mean(axis=0)


def return_of(z: np.ndarray) -> float:
    """A hill whose top is at 2, 2, 2, 2."""
    return float(np.exp(-np.linalg.norm(z - 2.0)))


print(f"at first: return {return_of(np.zeros(4)):.2f}")
for kind in (Elite, Power):
    learner = kind(4, kind.Settings(), np.random.default_rng(0))
    for _ in range(100):
        asked = learner.ask()
        learner.tell(asked, return_of(asked))
    print(f"{kind.__name__}: return {return_of(learner.mean):.2f}")
