# SPDX-License-Identifier: Apache-2.0
"""Rejection sampling of feasible coordinates; after 20 rejections, shrink to feasible ones.

Coordinates are infeasible when the simulation of their policy on the rigid-body model ends in a
fault. The number of rejections is logged: a replay passes it in, and nothing is simulated.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wam_power_ros.learning.learner import Learner

REJECTIONS_MAX = 20
HALVINGS_MAX = 5  # of the distance from coordinates that ran without a fault to infeasible ones


def sample(
    learner: Learner,
    ran: np.ndarray,
    is_feasible: Callable[[np.ndarray], bool],
    rejections: int | None = None,
) -> tuple[np.ndarray, int]:
    """Draw a feasible sample from a learner; after 20 infeasible ones, shrink the last.

    Args:
        learner: Learner to draw from.
        ran: Coordinates that ran without a fault. Shape (size,).
        is_feasible: Returns whether coordinates are feasible; must be deterministic.
        rejections: Logged number of rejections in a replay, else None.

    Returns:
        Coordinates (size,), and the number of rejections and halvings.
    """
    draws = REJECTIONS_MAX if rejections is None else min(rejections + 1, REJECTIONS_MAX)
    for count in range(draws):
        z = learner.ask()
        if rejections is None and is_feasible(z):
            return z, count
    if rejections is not None and rejections < REJECTIONS_MAX:
        return z, rejections
    halvings = None if rejections is None else rejections - REJECTIONS_MAX
    z, halvings = shrink(z, ran, is_feasible, halvings)
    return z, REJECTIONS_MAX + halvings


def shrink(
    z: np.ndarray,
    ran: np.ndarray,
    is_feasible: Callable[[np.ndarray], bool],
    halvings: int | None = None,
) -> tuple[np.ndarray, int]:
    """Halve the distance from `ran` to `z` until the coordinates are feasible.

    Args:
        z: Desired coordinates. Shape (size,).
        ran: Coordinates that ran without a fault; not simulated again. Shape (size,).
        is_feasible: Returns whether coordinates are feasible; must be deterministic.
        halvings: Logged number of halvings in a replay, else None.

    Returns:
        Coordinates (size,), and the number of halvings.
    """
    nearer = [z, *(ran + 0.5**count * (z - ran) for count in range(1, HALVINGS_MAX)), ran]
    if halvings is None:
        feasible = (count for count in range(HALVINGS_MAX) if is_feasible(nearer[count]))
        halvings = next(feasible, HALVINGS_MAX)
    return nearer[halvings], halvings
