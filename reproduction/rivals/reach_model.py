# SPDX-License-Identifier: Apache-2.0
"""Model of reaching: the free path of Eq. 1, and obstacles inferred from stopped rollouts."""

from __future__ import annotations

import numpy as np

from reproduction.studies.reaching_scenario import Scenario
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.tasks.reach.paths import held

CONTACT_RADIUS = 0.04  # distance from a known contact within which contact is predicted [m]
CONTACT_OFFSET = 0.02  # distance of an inferred contact beyond the first sample not reached [m]
CHECK_STRIDE = 4  # samples of a path from one contact check to the next, at most 4 cm apart


class ReachModel:
    """A model of Eq. 4: the path of Eq. 1, stopped at contacts of earlier rollouts.

    Eq. 1, the demonstration and the return are known, the obstacle is not: the location of a
    contact is inferred from the known path and the return of a rollout. Later paths are predicted
    to stop within CONTACT_RADIUS of it. The inference is exact for returns without noise.
    """

    def __init__(
        self, parameters: Parametrization, scenario: Scenario, tolerance: float = 1e-9
    ) -> None:
        """Start without contacts.

        Args:
            parameters: Map from coordinates to policies.
            scenario: Demonstrations and return; its obstacle is not used.
            tolerance: Largest deviation from the return of the free path that is not a contact.
        """
        self._tolerance = tolerance
        self._parameters = parameters
        self._scenario = scenario
        self._contacts: list[np.ndarray] = []  # (3,) each [m]

    def predict(self, z: np.ndarray) -> np.ndarray:
        """Predict the returns at z (B, size). Shape (B,)."""
        path = self._free(z)
        checked = path[:, ::CHECK_STRIDE]
        blocked = np.zeros(checked.shape[:2], dtype=bool)
        for contact in self._contacts:
            blocked |= ((checked - contact) ** 2).sum(axis=-1) < CONTACT_RADIUS**2
        stop = np.maximum(blocked.argmax(axis=1) * CHECK_STRIDE - 1, 0)
        last = np.where(blocked.any(axis=1), stop, path.shape[1] - 1)
        return self._scenario.returns(held(path, last))

    def learn(self, z: np.ndarray, ret: float) -> None:
        """Infer from the return whether and where the rollout at z (size,) was stopped."""
        path = self._free(z[np.newaxis])
        steps = path.shape[1]
        stops = held(np.repeat(path, steps, axis=0), np.arange(steps))  # (T, T, 3)
        deviation = np.abs(self._scenario.returns(stops) - ret)
        if deviation[-1] <= deviation.min() + self._tolerance:
            return  # not stopped
        last = int(deviation.argmin())
        step = path[0, last + 1] - path[0, last]
        length = max(float(np.linalg.norm(step)), 1e-9)
        self._contacts.append(path[0, last + 1] + CONTACT_OFFSET / length * step)

    def _free(self, z: np.ndarray) -> np.ndarray:
        stiffness, attractors, _ = self._parameters.arrays(z)
        return self._scenario.free_paths(stiffness, attractors)
