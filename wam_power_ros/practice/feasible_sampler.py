# SPDX-License-Identifier: Apache-2.0
"""Rejection sampling of infeasible policies; after 20 rejections, shrink to the best feasible one.

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
HALVINGS_MAX = 5  # of the way from what ran without a fault to what is infeasible

Infeasible = Callable[[Policy], Fault | None]  # fault in which a policy would end, None for none


class FeasibleSampler:
    """Feasible coordinates about one demonstration.

    The number of rejections goes into the log: where it is known, in a replay, nothing is asked.

    Args:
        parametrization: Parametrization of the demonstration.
        infeasible: Fault in which a policy would end, None when it is feasible; the same policy
            must always get the same answer.
    """

    def __init__(self, parametrization: Parametrization, infeasible: Infeasible) -> None:
        self._parametrization = parametrization
        self._infeasible = infeasible

    def sample(
        self, learner: Learner, ran: np.ndarray, rejections: int | None = None
    ) -> tuple[np.ndarray, int]:
        """A feasible sample of a learner; the last of 20 infeasible ones is shrunk.

        Args:
            learner: Learner that is asked.
            ran: Coordinates that ran without a fault. Shape (size,).
            rejections: Number of rejections, where it is known.

        Returns:
            Coordinates (size,), and the number of rejections and halvings.
        """
        asked = REJECTIONS_MAX if rejections is None else min(rejections + 1, REJECTIONS_MAX)
        for count in range(asked):
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
        """Coordinates themselves or, where infeasible, the first feasible ones on the way to `ran`.

        Args:
            z: Wanted coordinates. Shape (size,).
            ran: Coordinates that ran without a fault; taken without asking. Shape (size,).
            halvings: Number of halvings, where it is known.

        Returns:
            Coordinates (size,), and the number of times the way to them was halved.
        """
        nearer = [z, *(ran + 0.5**count * (z - ran) for count in range(1, HALVINGS_MAX)), ran]
        if halvings is None:
            feasible = (count for count in range(HALVINGS_MAX) if self._is_feasible(nearer[count]))
            halvings = next(feasible, HALVINGS_MAX)
        return nearer[halvings], halvings

    def _is_feasible(self, z: np.ndarray) -> bool:
        return self._infeasible(self._parametrization.policy(z, "sample")[0]) is None
