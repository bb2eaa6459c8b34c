# SPDX-License-Identifier: Apache-2.0
"""What is known of a reach before it is tried, and what stopped rollouts tell of the obstacle."""

from __future__ import annotations

import numpy as np

from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.tasks.reach.scenario import Scenario, held

REACH = 0.04  # [m] from a place where something was met within which it is expected again
AHEAD = 0.02  # [m] beyond the first sample that was not reached: what stopped it has a depth
EVERY = 4  # samples of a path from one that is looked at to the next: 4 cm at most


class FreePath:
    """A `learner.Model` of Eq. 4: the path of Eq. 1, which stops where something was met before.

    Known from the start are Eq. 1, the demonstration and the return. The obstacle is not: where a
    rollout was stopped follows from its return, the path being known. There, and `REACH` about
    it, a later path is expected to stop as well.
    """

    def __init__(self, parameters: Parametrization, scenario: Scenario) -> None:
        """Know the free path; of `scenario` the obstacle is not looked at."""
        self._parameters = parameters
        self._scenario = scenario
        self._met: list[np.ndarray] = []  # (3,) each

    def predict(self, z: np.ndarray) -> np.ndarray:
        """Returns to expect at z (B, size). Shape (B,)."""
        path = self._free(z)
        seen = path[:, ::EVERY]
        blocked = np.zeros(seen.shape[:2], dtype=bool)
        for place in self._met:
            blocked |= ((seen - place) ** 2).sum(axis=-1) < REACH**2
        stop = np.maximum(blocked.argmax(axis=1) * EVERY - 1, 0)
        last = np.where(blocked.any(axis=1), stop, path.shape[1] - 1)
        return self._scenario.worth(held(path, last))

    def learn(self, z: np.ndarray, ret: float) -> None:
        """Find out from its return whether z (size,) was stopped, and where."""
        path = self._free(z[np.newaxis])
        steps = path.shape[1]
        stops = held(np.repeat(path, steps, axis=0), np.arange(steps))  # (T, T, 3)
        off = np.abs(self._scenario.worth(stops) - ret)
        if off[-1] <= off.min() + 1e-9:
            return  # it went all the way
        last = int(off.argmin())
        step = path[0, last + 1] - path[0, last]
        length = max(float(np.linalg.norm(step)), 1e-9)
        self._met.append(path[0, last + 1] + AHEAD / length * step)

    def _free(self, z: np.ndarray) -> np.ndarray:
        stiffness, attractors, _ = self._parameters.arrays(z)
        return self._scenario.free(stiffness, attractors)
