# SPDX-License-Identifier: Apache-2.0
"""Rejection sampling of feasible policies; after 20 rejections, shrink towards a feasible one.

A policy is infeasible when its simulation on the rigid-body model ends in a fault.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wam_power_ros.learning.learner import Learner
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Fault

REJECTIONS_MAX = 20
HALVINGS_MAX = 5  # of the distance from coordinates that ran without a fault to infeasible ones


class FeasibleSampler:
    """Samples feasible coordinates around one demonstration.

    The number of rejections is logged: a replay passes it in, and no policy is simulated.

    Args:
        parametrization: Parametrization of the demonstration.
        infeasible: Returns the fault in which a policy would end, None when it is feasible; must be
            deterministic.
    """

    def __init__(
        self, parametrization: Parametrization, infeasible: Callable[[Policy], Fault | None]
    ) -> None:
        self._parametrization = parametrization
        self._infeasible = infeasible

    def sample(
        self, learner: Learner, ran: np.ndarray, rejections: int | None = None
    ) -> tuple[np.ndarray, int]:
        """Draw a feasible sample from a learner; after 20 infeasible ones, shrink the last.

        Args:
            learner: Learner to draw from.
            ran: Coordinates that ran without a fault. Shape (size,).
            rejections: Logged number of rejections in a replay, else None.

        Returns:
            Coordinates (size,), and the number of rejections and halvings.
        """
        draws = REJECTIONS_MAX if rejections is None else min(rejections + 1, REJECTIONS_MAX)
        for count in range(draws):
            z = learner.ask()
            if rejections is None and self._is_feasible(z):
                return z, count
        if rejections is not None and rejections < REJECTIONS_MAX:
            return z, rejections
        halvings = None if rejections is None else rejections - REJECTIONS_MAX
        z, halvings = self.shrunk(z, ran, halvings)
        return z, REJECTIONS_MAX + halvings

    def shrunk(
        self, z: np.ndarray, ran: np.ndarray, halvings: int | None = None
    ) -> tuple[np.ndarray, int]:
        """Halve the distance from `ran` to `z` until the coordinates are feasible.

        Args:
            z: Desired coordinates. Shape (size,).
            ran: Coordinates that ran without a fault; not simulated again. Shape (size,).
            halvings: Logged number of halvings in a replay, else None.

        Returns:
            Coordinates (size,), and the number of halvings.
        """
        nearer = [z, *(ran + 0.5**count * (z - ran) for count in range(1, HALVINGS_MAX)), ran]
        if halvings is None:
            feasible = (count for count in range(HALVINGS_MAX) if self._is_feasible(nearer[count]))
            halvings = next(feasible, HALVINGS_MAX)
        return nearer[halvings], halvings

    def _is_feasible(self, z: np.ndarray) -> bool:
        return self._infeasible(self._parametrization.policy(z, "sample")[0]) is None
