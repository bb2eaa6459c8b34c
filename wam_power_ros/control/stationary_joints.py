# SPDX-License-Identifier: Apache-2.0
"""Joints that report the same position, bit for bit, while their reference moves.

Either friction holds such a joint, or its reported position is frozen while the arm moves. The
torque tells the two apart: friction holds a joint against at most twice its nominal friction.
"""

from __future__ import annotations

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.tracking_error import TrackingLost

REFERENCE_MOTION = 5e-4  # [rad] of the reference since the joint stands still: 5 encoder counts
FREE_SPEED_MAX = 0.2  # [rad/s] largest speed that the feedback may give the joint if it is free
FRICTION_FACTOR = 2.0  # multiple of its nominal friction that may hold a joint
TORQUE_SHARE = 0.04  # share of its torque limit added to that: a pan 20 % lighter or heavier
MOTION_TIMEOUT = 10  # states within which a joint must move under more torque than may hold it


class StationaryJoints:
    """Bounds the feedback torque at joints that stand still while their reference moves.

    Feedback that friction may hold acts in full only until a free joint would have reached
    `FREE_SPEED_MAX`, then with opposite sign until a free joint would be at rest again, then not at
    all. Feedback above that always acts, and the joint must move.

    Args:
        arm: Model of the arm.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._holdable = (FRICTION_FACTOR * arm.friction + TORQUE_SHARE * arm.tau_max).tolist()
        self._friction = arm.friction.tolist()
        self.begin()

    def begin(self) -> None:
        """Restart: no joint counts as stationary."""
        n = self._arm.n
        self._q: list[float] = [float("nan")] * n  # reported position [rad]
        self._q_ref = [0.0] * n  # reference when the joint first reported this position [rad]
        self._free_speed = [0.0] * n  # speed that a free joint would have [rad/s]
        self._reached = [False] * n  # whether this speed has reached its maximum
        self._overdue = [0] * n  # states under more torque than friction can hold

    def joints(self, q: np.ndarray, q_ref: np.ndarray) -> list[int]:
        """Stationary joints whose reference moves, at a new state: q, q_ref (n,) [rad]."""
        found = []
        for i, (position, reference) in enumerate(zip(q.tolist(), q_ref.tolist(), strict=True)):
            if position != self._q[i]:
                self._q[i], self._q_ref[i] = position, reference
                self._free_speed[i], self._reached[i], self._overdue[i] = 0.0, False, 0
            elif abs(reference - self._q_ref[i]) > REFERENCE_MOTION:
                found.append(i)
        return found

    def bounded(
        self, joints: list[int], feedback: np.ndarray, inertia: np.ndarray, dt: float
    ) -> np.ndarray:
        """Bound the feedback torque at stationary joints [N m]. Shape (n,).

        Args:
            joints: Stationary joints, from `joints`.
            feedback: Torque in addition to gravity and the reference's acceleration [N m].
            inertia: Inertia of every joint with the others locked [kg m^2]. Shape (n,).
            dt: Time since the last state [s].

        Raises:
            TrackingLost: A joint does not move although friction cannot hold it.
        """
        bounded = feedback.copy()
        for i in joints:
            size, friction = abs(feedback[i]), self._friction[i]
            if size > self._holdable[i]:
                self._overdue[i] += 1
                if self._overdue[i] > MOTION_TIMEOUT:
                    text = f"joint {i + 1} does not move under a feedback torque of"
                    raise TrackingLost(f"{text} {feedback[i]:.1f} N m")
                continue
            self._overdue[i] = 0
            speed = self._free_speed[i]
            if not self._reached[i]:
                self._free_speed[i] = max(speed + (size - friction) / inertia[i] * dt, 0.0)
                self._reached[i] = self._free_speed[i] >= FREE_SPEED_MAX
                continue
            bounded[i] = -feedback[i] if speed > 0.0 else 0.0
            self._free_speed[i] = max(speed - (size + friction) / inertia[i] * dt, 0.0)
        return bounded
