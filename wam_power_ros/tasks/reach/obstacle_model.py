# SPDX-License-Identifier: Apache-2.0
"""Prediction of a reach: the free path of Eq. 1, and obstacles inferred from stopped rollouts."""

from __future__ import annotations

import numpy as np

from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.tasks.reach.scenario import Scenario, held

REACH = 0.04  # [m] radius about a contact within which another contact is predicted
AHEAD = 0.02  # [m] of a contact beyond the first sample that was not reached
EVERY = 4  # samples between those of a path that are checked: 4 cm at most


class FreePath:
    """A `learner.Model` of Eq. 4: the path of Eq. 1, stopped at contacts of earlier rollouts.

    It is given Eq. 1, the demonstration and the return, but no obstacle: the place of a contact
    is inferred from the return of a rollout, its path being known. Later paths are predicted to
    stop within `REACH` of it. The inference is exact for returns without noise.
    """

    def __init__(
        self, parameters: Parametrization, scenario: Scenario, tolerance: float = 1e-9
    ) -> None:
        """Start without any contact; the obstacle of `scenario` is not used.

        Args:
            parameters: Meaning of the coordinates.
            scenario: Reach without its obstacle.
            tolerance: Deviation of a return from that of the free path that is no contact yet.
        """
        self._tolerance = tolerance
        self._parameters = parameters
        self._scenario = scenario
        self._met: list[np.ndarray] = []  # (3,) each

    def predict(self, z: np.ndarray) -> np.ndarray:
        """Predicted returns at z (B, size). Shape (B,)."""
        path = self._free(z)
        seen = path[:, ::EVERY]
        blocked = np.zeros(seen.shape[:2], dtype=bool)
        for place in self._met:
            blocked |= ((seen - place) ** 2).sum(axis=-1) < REACH**2
        stop = np.maximum(blocked.argmax(axis=1) * EVERY - 1, 0)
        last = np.where(blocked.any(axis=1), stop, path.shape[1] - 1)
        return self._scenario.worth(held(path, last))

    def learn(self, z: np.ndarray, ret: float) -> None:
        """Infer from its return whether the rollout at z (size,) was stopped, and where."""
        path = self._free(z[np.newaxis])
        steps = path.shape[1]
        stops = held(np.repeat(path, steps, axis=0), np.arange(steps))  # (T, T, 3)
        off = np.abs(self._scenario.worth(stops) - ret)
        if off[-1] <= off.min() + self._tolerance:
            return  # it went all the way
        last = int(off.argmin())
        step = path[0, last + 1] - path[0, last]
        length = max(float(np.linalg.norm(step)), 1e-9)
        self._met.append(path[0, last + 1] + AHEAD / length * step)

    def _free(self, z: np.ndarray) -> np.ndarray:
        stiffness, attractors, _ = self._parameters.arrays(z)
        return self._scenario.free(stiffness, attractors)
