# SPDX-License-Identifier: Apache-2.0
"""Paths of a pan for the tests of tosses."""

from __future__ import annotations

import numpy as np

from wam_power_ros.learning.rollout import EndEffectorPath

RISE = 0.2  # [s]
BRAKE = 60.0  # [m/s^2]


def path(z: np.ndarray, pitch: np.ndarray, x: np.ndarray | None = None) -> EndEffectorPath:
    """Path of a pan at 500 Hz; pitch with the front edge up [rad]."""
    x = np.zeros_like(z) if x is None else x
    quat_xyzw = np.column_stack(
        [np.zeros_like(z), -np.sin(0.5 * pitch), np.zeros_like(z), np.cos(0.5 * pitch)]
    )
    return EndEffectorPath(
        "pan", 0.002 * np.arange(len(z)), np.column_stack([x, 0.0 * z, z]), quat_xyzw
    )


def thrown(
    speed: float, tilt: float = 0.0, rate: float = 0.0, ahead: float = 0.0
) -> EndEffectorPath:
    """A pan that rises to `speed` [m/s] while it turns ever faster, and stops within centimetres.

    From the release on it turns at a constant rate [rad/s]; later it moves ahead [m].
    """
    t = 0.002 * np.arange(751)
    stop = RISE + speed / BRAKE
    up, down = np.minimum(t, RISE), np.clip(t - RISE, 0.0, speed / BRAKE)
    z = 0.5 * speed / RISE * up**2 + speed * down - 0.5 * BRAKE * down**2
    pitch = tilt + rate * (0.5 * up**2 / RISE + np.maximum(t - RISE, 0.0))
    x = ahead * np.clip((t - stop) / 0.1, 0.0, 1.0)
    return path(z, pitch, x)
