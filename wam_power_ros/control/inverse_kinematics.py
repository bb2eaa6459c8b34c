# SPDX-License-Identifier: Apache-2.0
"""Inverse kinematics by damped least squares, from a posture that is near."""

from __future__ import annotations

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm

DAMPING = 1e-4


def damped_step(jacobian: np.ndarray, error: np.ndarray, damping: float = DAMPING) -> np.ndarray:
    """Step of the joints (n,) that lessens an error (m,), with its Jacobian (m, n)."""
    return jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(len(error)), error)


def posture_near(
    arm: Arm, q: np.ndarray, position: np.ndarray, rotation: np.ndarray, steps: int
) -> np.ndarray:
    """Posture (n,) [rad] near q (n,) [rad], within the limits, that brings the tool to a pose.

    The pose is a position (3,) [m] and a rotation (3, 3) in the base frame. After few steps, or
    where the arm does not reach, the tool is not there yet.
    """
    for _ in range(steps):
        now, turned = arm.tool_pose(q)
        error = np.concatenate([position - now, rotations.log_of_one(rotation @ turned.T)])
        q = np.clip(q + damped_step(arm.jacobian(q), error), arm.q_min, arm.q_max)
    return q
