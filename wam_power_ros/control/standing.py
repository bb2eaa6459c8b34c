# SPDX-License-Identifier: Apache-2.0
"""Joints that report the same position, bit for bit, while their reference moves.

Friction may hold such a joint, or its position is frozen and the arm moves on. What a joint in
friction bears without moving tells the two apart: no more than twice its friction.
"""

from __future__ import annotations

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.tracking_error import TrackingLost

MOVED = 5e-4  # [rad] that the reference has moved since the joint stands: five counts of an encoder
SPEED = 0.2  # [rad/s] that it would reach if it were free, before it is pushed no more
FRICTION_SHARE = 2.0  # of its friction that may hold a joint
TORQUE_SHARE = 0.04  # of its torque limit, beside that: a pan 20 % lighter or heavier
PATIENCE = 10  # states in which a joint must move that is pushed by more than may hold it


class StandingJoints:
    """Bounds the push at joints that stand while their reference moves.

    Below what may hold a joint, it is pushed in full only until it would have become fast if it
    were free, then as hard the other way until it would be at rest again, and no more. Above,
    always, and then it must move.

    Args:
        arm: Model of the arm.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._holds = (FRICTION_SHARE * arm.friction + TORQUE_SHARE * arm.tau_max).tolist()
        self._friction = arm.friction.tolist()
        self.begin()

    def begin(self) -> None:
        """Begin anew: no joint stands."""
        n = self._arm.n
        self._at: list[float] = [float("nan")] * n  # position since it stands [rad]
        self._since = [0.0] * n  # reference when it came to stand [rad]
        self._speed = [0.0] * n  # speed it would have, were it free [rad/s]
        self._spent = [False] * n  # it has been pushed for long enough
        self._due = [0] * n  # states since it should have moved

    def suspects(self, q: np.ndarray, q_ref: np.ndarray) -> list[int]:
        """Joints that stand while their reference, (n,) [rad], moves; `q` (n,) [rad] is new."""
        found = []
        for i, (at, ref) in enumerate(zip(q.tolist(), q_ref.tolist(), strict=True)):
            if at != self._at[i]:
                self._at[i], self._since[i], self._speed[i], self._due[i] = at, ref, 0.0, 0
                self._spent[i] = False
            elif abs(ref - self._since[i]) > MOVED:
                found.append(i)
        return found

    def bounded(
        self, joints: list[int], push: np.ndarray, inertia: np.ndarray, dt: float
    ) -> np.ndarray:
        """What is left of a push (n,) [N m].

        Args:
            joints: Joints that stand, see `suspects`.
            push: Torque beside that of gravity and of the reference's acceleration [N m].
            inertia: Inertia of every joint, the others held [kg m^2]. Shape (n,).
            dt: Time since the state before [s].

        Raises:
            TrackingLost: A joint does not move although friction cannot hold it.
        """
        left = push.copy()
        for i in joints:
            size, friction = abs(push[i]), self._friction[i]
            if size > self._holds[i]:
                self._due[i] += 1
                if self._due[i] > PATIENCE:
                    raise TrackingLost(f"joint {i + 1} stands, pushed with {push[i]:.1f} N m")
                continue
            self._due[i] = 0
            if not self._spent[i]:
                self._speed[i] = max(self._speed[i] + (size - friction) / inertia[i] * dt, 0.0)
                self._spent[i] = self._speed[i] >= SPEED
                continue
            left[i] = -push[i] if self._speed[i] > 0.0 else 0.0
            self._speed[i] = max(self._speed[i] - (size + friction) / inertia[i] * dt, 0.0)
        return left
