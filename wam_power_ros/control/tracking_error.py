# SPDX-License-Identifier: Apache-2.0
"""How well the arm follows a replayed movement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

SAMPLE = 5  # states from one look at the tool to the next


class ToolPose(Protocol):
    """What is needed of an arm model."""

    n: int

    def tool_pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] (3,) and rotation matrix (3, 3) of the tool frame in the base frame."""


class TrackingLost(RuntimeError):
    """The arm is too far from its reference to follow it."""


class FollowingError:
    """How far the arm is from what it follows, told state by state.

    Attributes:
        count: States so far.
        largest: Of each joint so far [rad]. Shape (n,).

    Args:
        arm: For its forward kinematics.
        states: How many there will be, about.
    """

    def __init__(self, arm: ToolPose, states: int) -> None:
        self._arm = arm
        self.count = 0
        self.largest = np.zeros(arm.n)
        self._squares = np.zeros(arm.n)
        self._looks = np.empty((states // SAMPLE + 2, 2, arm.n))

    def add(self, q_ref: np.ndarray, q: np.ndarray) -> None:
        """One state: wanted and measured posture [rad]; each (n,)."""
        error = q_ref - q
        self._squares += error * error
        np.maximum(self.largest, np.abs(error), out=self.largest)
        look, rest = divmod(self.count, SAMPLE)
        if rest == 0 and look < len(self._looks):
            self._looks[look, 0], self._looks[look, 1] = q_ref, q
        self.count += 1

    @property
    def rms(self) -> np.ndarray:
        """Root mean square of each joint so far [rad]. Shape (n,)."""
        return np.sqrt(self._squares / max(self.count, 1))

    def tool(self) -> tuple[float, float]:
        """Root mean square and largest distance of the tool from where it should be [m]."""
        looks = self._looks[: -(-self.count // SAMPLE)]
        if not len(looks):
            return 0.0, 0.0
        places = [[self._arm.tool_pose(q)[0] for q in look] for look in looks]
        away = np.linalg.norm(np.diff(np.array(places), axis=1), axis=2)
        return float(np.sqrt(np.mean(away**2))), float(away.max())

    def text(self, joint_names: Sequence[str]) -> str:
        """A few lines for a person."""
        rms, (tool_rms, tool_largest) = self.rms, self.tool()
        lines = [
            f"rms error {rms.max():.4f} rad in the worst joint, {joint_names[int(rms.argmax())]}",
            f"tool: rms {tool_rms * 1e3:.1f} mm, at most {tool_largest * 1e3:.1f} mm",
        ]
        lines += [
            f"{name}: rms {of_rms:.4f} rad, at most {largest:.4f} rad"
            for name, of_rms, largest in zip(joint_names, rms, self.largest, strict=True)
        ]
        return "\n".join(lines)
