# SPDX-License-Identifier: Apache-2.0
"""Hold of an arm that a fault has stopped, by bounded feedback."""

import numpy as np

from wam_power_ros.control.arm import Arm

FREQUENCY = 20.0  # [rad/s] with a damping of 20 1/s: half of the critical damping
FRICTION_FACTOR = 2.0  # multiple of a joint's friction in the bound of the feedback
TORQUE_SHARE = 0.05  # share of a joint's torque limit added to it: payload, tilt, weak motors


def feedback_max(arm: Arm) -> np.ndarray:
    """Bound on the feedback that holds a stopped arm [N m]. Shape (n,)."""
    return FRICTION_FACTOR * arm.friction + TORQUE_SHARE * arm.tau_max


class FaultHold:
    """Feedback that keeps the arm where it was when the hold began.

    Without stiffness an arm that is not its model moves on after a fault: 0.5 kg at the tool carry
    the WAM 23 cm away within 10 s, and no reset is possible meanwhile.

    Args:
        arm: Model of the arm.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._bound = feedback_max(arm)
        self._at: np.ndarray | None = None  # posture that is held [rad]

    def release(self) -> None:
        """Give no torque; the next call of `torque` takes the posture to hold."""
        self._at = None

    def torque(self, q: np.ndarray) -> np.ndarray:
        """Feedback torque at a measured posture (n,) [rad], within its bound [N m]. Shape (n,)."""
        if self._at is None:
            self._at = q
        feedback = FREQUENCY**2 * self._arm.mass_matrix(q).dot(self._at - q)
        return np.minimum(np.maximum(feedback, -self._bound), self._bound)
