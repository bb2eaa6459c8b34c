# SPDX-License-Identifier: Apache-2.0
"""Tracking error of a replayed movement."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from wam_power_ros.control.arm import Arm

TOOL_STRIDE = 5  # states from one comparison of tool positions to the next


class TrackingLost(RuntimeError):
    """The arm is too far from its reference to follow it."""


class TrackingError:
    """Running statistics of the error between reference and measured posture.

    Attributes:
        count: Number of states so far.
        largest: Largest error of each joint so far [rad]. Shape (n,).

    Args:
        arm: Model of the arm, for its forward kinematics.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self.count = 0
        self.largest = np.zeros(arm.n)
        self._squares = np.zeros(arm.n)
        # Tool positions are compared during the movement: at its end it would take too long.
        self._tool_count = 0
        self._tool_squares, self._tool_largest = 0.0, 0.0

    def add(self, q_ref: np.ndarray, q: np.ndarray) -> None:
        """Add one state: reference and measured posture [rad]. Shapes (n,)."""
        error = q_ref - q
        self._squares += error * error
        np.maximum(self.largest, np.abs(error), out=self.largest)
        if self.count % TOOL_STRIDE == 0:
            tool_error = self._arm.tool_pose(q_ref)[0] - self._arm.tool_pose(q)[0]
            distance = math.hypot(*tool_error.tolist())
            self._tool_count += 1
            self._tool_squares += distance * distance
            self._tool_largest = max(self._tool_largest, distance)
        self.count += 1

    @property
    def rms(self) -> np.ndarray:
        """Root mean square error of each joint so far [rad]. Shape (n,)."""
        return np.sqrt(self._squares / max(self.count, 1))

    def tool(self) -> tuple[float, float]:
        """Root mean square and largest distance of the tool from its reference [m]."""
        return math.sqrt(self._tool_squares / max(self._tool_count, 1)), self._tool_largest

    def text(self, joint_names: Sequence[str]) -> str:
        """Summary in a few lines."""
        rms, (tool_rms, tool_largest) = self.rms, self.tool()
        lines = [
            f"rms error {rms.max():.4f} rad in the worst joint, {joint_names[int(rms.argmax())]}",
            f"tool: rms {tool_rms * 1e3:.1f} mm, at most {tool_largest * 1e3:.1f} mm",
        ]
        lines += [
            f"{name}: rms {joint_rms:.4f} rad, at most {largest:.4f} rad"
            for name, joint_rms, largest in zip(joint_names, rms, self.largest, strict=True)
        ]
        return "\n".join(lines)
