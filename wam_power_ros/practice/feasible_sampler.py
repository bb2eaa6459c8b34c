# SPDX-License-Identifier: Apache-2.0
"""What the arm may try of what a learner wants: the forbidden is drawn again, or drawn back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.power import Power

REDRAWS_MAX = 20
HALVINGS_MAX = 5  # of the way from what ran without a fault to what is forbidden


class Permission:
    """The coordinates that may be tried about one demonstration.

    What it takes to come to them is counted, and the count goes into the log: where it is known,
    in a replay, nothing is asked.

    Args:
        parameters: of the demonstration.
        forbidden: why the arm must not try a policy, empty if it may; the same policy must always
            get the same answer, and an answer's is asked for before every re-test.
    """

    def __init__(self, parameters: Parametrization, forbidden: Callable[[Policy], str]) -> None:
        self._parameters = parameters
        self._forbidden = forbidden

    def sample(
        self, learner: Power, ran: np.ndarray, redrawn: int | None = None
    ) -> tuple[np.ndarray, int]:
        """A learner's sample that is not forbidden; the last one drawn back if 20 are.

        Args:
            learner: that is asked.
            ran: coordinates that ran without a fault. Shape (size,)
            redrawn: the count, where it is known.

        Returns:
            Coordinates (size,), and how many samples were forbidden and how often the last was
            drawn back.
        """
        asked = REDRAWS_MAX if redrawn is None else min(redrawn + 1, REDRAWS_MAX)
        for count in range(asked):
            z = learner.ask()
            if redrawn is None and not self._forbids(z):
                return z, count
        if redrawn is not None and redrawn < REDRAWS_MAX:
            return z, redrawn
        z, halved = self.drawn_back(z, ran, None if redrawn is None else redrawn - REDRAWS_MAX)
        return z, REDRAWS_MAX + halved

    def drawn_back(
        self, z: np.ndarray, ran: np.ndarray, halved: int | None = None
    ) -> tuple[np.ndarray, int]:
        """What is wanted or, where that is forbidden, the first allowed of some nearer to what ran.

        Args:
            z: that is wanted. Shape (size,)
            ran: coordinates that ran without a fault, allowed whatever is asked. Shape (size,)
            halved: the count, where it is known.

        Returns:
            Coordinates (size,), and how often they were drawn back.
        """
        nearer = [z, *(ran + 0.5**count * (z - ran) for count in range(1, HALVINGS_MAX)), ran]
        if halved is None:
            allowed = (count for count in range(HALVINGS_MAX) if not self._forbids(nearer[count]))
            halved = next(allowed, HALVINGS_MAX)
        return nearer[halved], halved

    def _forbids(self, z: np.ndarray) -> bool:
        return bool(self._forbidden(self._parameters.policy(z, "sample")[0]))
