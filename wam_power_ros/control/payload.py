# SPDX-License-Identifier: Apache-2.0
"""Is the torque that nothing explains that of a mass which was put on the tool, or which it lost?

A false state can look like a force for a moment. A mass gives itself away: its torque is J^T m (g -
a), with the acceleration a of the tool that the states report, and m stays the same.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.state_checks import PastState, at_rate
from wam_power_ros.learning.policy import PERIOD

GRAVITY = 9.81  # [m/s^2]
ACCELERATION_STATES = 8  # half of the states from which an acceleration is measured, at 500 Hz
STEADY_STATES = 15  # states in which the mass must be the same: 30 ms
STEADY_SHARE = 0.15  # by which it may differ from its mean in them
LOST, PUT, MOST = 0.25, 0.8, 3.5  # [kg] least mass lost and put on, and most of either
RECOGNITION_STATES = 100  # states of a fault in which a mass is recognized: 0.2 s
ANSWER_STATES = 10  # states after which a mass must still be seen when its weight is carried
ANSWER_SHARE = 0.5  # by which it may then differ from what was recognized
FRICTION_FACTOR, TORQUE_SHARE = 1.5, 0.02  # bound on what is left: of friction, of torque limits
CLEAR = 1.5  # multiple of this bound that the torque of a mass must have at one joint


class PayloadCheck:
    """Recognizes a mass at the tool by the torque that nothing explains.

    Attributes:
        refuted: True once a mass that was recognized turned out to be none: while its weight was
            carried, the estimate of the mass changed by more than half.
    """

    def __init__(self, arm: Arm, period: float = PERIOD) -> None:
        self._arm = arm
        self._half = at_rate(ACCELERATION_STATES, period)
        self._bound = FRICTION_FACTOR * arm.friction + TORQUE_SHARE * arm.tau_max
        self._masses: deque[float] = deque(maxlen=at_rate(STEADY_STATES, period))  # [kg]
        self._answer = at_rate(ANSWER_STATES, period)
        self._recognition = at_rate(RECOGNITION_STATES, period)
        self.begin()

    def begin(self) -> None:
        """Forget what was recognized."""
        self._masses.clear()
        self._found, self._carried, self.refuted = 0.0, 0, False
        self._asked = 0  # states since the fault

    def torque(self, past: Sequence[PastState]) -> np.ndarray | None:
        """Torque of the weight of this mass [N m], shape (n,); None if it is none.

        Args:
            past: Latest states, oldest first, with the torque that nothing explains.
        """
        rows = list(past)
        if not self._masses:
            for k in range(len(rows) - (self._masses.maxlen or 0), len(rows)):
                self._masses.append(self._mass(rows[: k + 1]))
        else:
            self._masses.append(self._mass(rows))
        masses = np.array(self._masses)
        mean = float(masses.mean())
        steady = (np.abs(masses - mean) <= STEADY_SHARE * abs(mean)).all()
        if self._found:
            self._carried += 1
            same = abs(masses[-1] - self._found) <= ANSWER_SHARE * abs(self._found)
            differs = masses[-1] != 0.0 and not same
            if self._carried > self._answer and differs:
                self._found, self.refuted = 0.0, True
        self._asked += 1
        early = self._found != 0.0 or self._asked < self._recognition
        if early and steady and not self.refuted and (-MOST < mean < -LOST or PUT < mean < MOST):
            self._found = mean
        if not self._found:
            return None
        return -self._found * GRAVITY * self._arm.jacobian(rows[-1].q)[2]

    def _mass(self, past: list[PastState]) -> float:
        """Mass that explains the torque of the last state [kg]; 0 if it is small, NaN if none."""
        half, bound = self._half, self._bound
        if len(past) <= 2 * half:
            return float("nan")
        first, middle, last = past[-1 - 2 * half], past[-1 - half], past[-1]
        seconds = sum(each.dt for each in past[-half:])
        qdd = (last.q - 2.0 * middle.q + first.q) / seconds**2
        lever = self._arm.jacobian(last.q)[2]
        unit = -lever * (GRAVITY + lever.dot(qdd)) / bound  # of 1 kg
        residual = np.array(last.external) / bound
        mass = float(unit.dot(residual) / max(unit.dot(unit), 1e-9))
        if np.abs(residual).max() < CLEAR:
            return 0.0
        return mass if np.abs(residual - mass * unit).max() < 1.0 else float("nan")
