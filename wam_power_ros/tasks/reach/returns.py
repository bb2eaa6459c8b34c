# SPDX-License-Identifier: Apache-2.0
"""Return of reaching around an obstacle (Eq. 4)."""

from __future__ import annotations

import numpy as np

W1, W2 = 0.5, 0.5  # weights of tracking the demonstration and of reaching the goal
# Unit of length in the exponents [m]. The paper does not name it; only decimetres give both of the
# returns that it reports, 0.61 with diagonal and 0.73 with full matrices.
UNIT = 0.1


def reaching_terms(
    path: np.ndarray, demonstrated: np.ndarray, goal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the two terms of `reaching_return`: tracking and goal. Shape (B,) each.

    Raises:
        ValueError: If shapes do not match or a value is not finite.
    """
    if path.ndim != 3 or path.shape[-2:] != demonstrated.shape or path.shape[-1] != 3:
        raise ValueError(f"path {path.shape} must be (B, T, 3), demonstrated {demonstrated.shape}")
    if not (np.isfinite(path).all() and np.isfinite(demonstrated).all()):
        raise ValueError("path and demonstrated must be finite")
    steps = path.shape[-2]
    deviation = np.linalg.norm(path[..., :-1, :] - demonstrated[:-1], axis=-1) / UNIT
    goal_distance = np.linalg.norm(path[..., -1, :] - goal, axis=-1) / UNIT
    return W1 / steps * np.exp(-deviation).sum(axis=-1), W2 * np.exp(-goal_distance)


def reaching_return(path: np.ndarray, demonstrated: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Return of many reaching rollouts (Eq. 4).

        R = sum_{t < t_e} w1/T exp(-|x_R(t) - x_D(t)|) + w2 exp(-|x_R(t_e) - x_G|)

    T is the number of samples and t_e the last one. The paths have to include collisions: see
    `paths.stopped_paths`.

    Args:
        path: x_R [m]. Shape (B, T, 3).
        demonstrated: x_D [m]. Shape (T, 3).
        goal: x_G [m]. Shape (3,).

    Returns:
        Returns, shape (B,); ValueErrors as of `reaching_terms`.
    """
    tracking, reached = reaching_terms(path, demonstrated, goal)
    return tracking + reached
