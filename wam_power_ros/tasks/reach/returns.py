# SPDX-License-Identifier: Apache-2.0
"""Return of reaching around an obstacle (Eq. 4)."""

from __future__ import annotations

import numpy as np

W1, W2 = 0.5, 0.5  # weights of following the demonstration and of reaching the goal
UNIT = 0.1  # [m] of length in the exponents. The paper names none; only decimetres give both of
# the returns it reports, 0.61 before and 0.73 after learning


def reaching_terms(
    path: np.ndarray, demonstrated: np.ndarray, goal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The two terms of `reaching_return` of many paths: following and goal. Shape (B,) each.

    Raises:
        ValueError: Shapes do not fit, or a value is not finite.
    """
    if path.ndim != 3 or path.shape[-2:] != demonstrated.shape or path.shape[-1] != 3:
        raise ValueError(f"path {path.shape} must be (B, T, 3), demonstrated {demonstrated.shape}")
    if not (np.isfinite(path).all() and np.isfinite(demonstrated).all()):
        raise ValueError("path and demonstrated must be finite")
    steps = path.shape[-2]
    astray = np.linalg.norm(path[..., :-1, :] - demonstrated[:-1], axis=-1) / UNIT
    missed = np.linalg.norm(path[..., -1, :] - goal, axis=-1) / UNIT
    return W1 / steps * np.exp(-astray).sum(axis=-1), W2 * np.exp(-missed)


def reaching_return(path: np.ndarray, demonstrated: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Return of many reaching rollouts (Eq. 4).

        R = sum_{t < t_e} w1/T exp(-|x_R(t) - x_D(t)|) + w2 exp(-|x_R(t_e) - x_G|)

    T is the number of samples and t_e the last. On collision the end-effector stays where it is;
    `Scenario.stopped` makes such paths, this formula sees only the path.

    Args:
        path: x_R [m]. Shape (B, T, 3).
        demonstrated: x_D [m]. Shape (T, 3).
        goal: x_G [m]. Shape (3,).

    Returns:
        Shape (B,).

    Raises:
        ValueError: Shapes do not fit, or a value is not finite.
    """
    following, reached = reaching_terms(path, demonstrated, goal)
    return following + reached
