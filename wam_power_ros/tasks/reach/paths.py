# SPDX-License-Identifier: Apache-2.0
"""Paths of reaching: demonstrated ones at even times, and those that end at an obstacle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wam_power_ros.learning.demonstration import Demonstration

STEPS = 200  # number of samples T of Eq. 4


def resampled(demonstrations: Sequence[Demonstration]) -> np.ndarray:
    """Tool positions at STEPS evenly spaced times of each demonstration [m]. (count, STEPS, 3)."""
    grid = np.linspace(0.0, 1.0, STEPS)
    return np.stack(
        [
            np.stack([np.interp(grid, d.t / d.duration, x) for x in d.position.T], axis=1)
            for d in demonstrations
        ]
    )


def stopped_paths(
    path: np.ndarray, centre: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Stop paths at their last sample before a sphere.

    The segments between samples are checked: a fast rollout does not jump through the sphere.

    Args:
        path: Positions [m]. Shape (B, T, 3).
        centre: Centre of the sphere [m]. Shape (3,).
        radius: Radius of the sphere [m]; 0 for none.

    Returns:
        Positions [m], shape (B, T, 3), and whether each path collided, shape (B,).
    """
    step = np.diff(path, axis=1)  # (B, T-1, 3)
    offset = centre - path[:, :-1]
    length2 = np.maximum((step**2).sum(axis=-1), 1e-300)
    share = np.clip((offset * step).sum(axis=-1) / length2, 0.0, 1.0)
    hit = np.linalg.norm(offset - share[..., None] * step, axis=-1) < radius  # (B, T-1)
    collided = hit.any(axis=1)
    return held(path, np.where(collided, hit.argmax(axis=1), path.shape[1] - 1)), collided


def held(path: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Hold paths (B, T, 3) at their sample `last` (B,) from there on. Shape (B, T, 3)."""
    index = np.minimum(np.arange(path.shape[1]), last[:, None])  # (B, T)
    return np.take_along_axis(path, index[..., None], axis=1)
