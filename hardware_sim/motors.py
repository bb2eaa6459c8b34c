# SPDX-License-Identifier: Apache-2.0
"""What the WAM's seven motors can give: cable limits and the torque-speed envelope of a bus voltage.

Joints 2-3 and 5-6 share two motors each through differentials, so limits hold for motors, and a
joint's limit depends on what its neighbour asks.
"""

from __future__ import annotations

import numpy as np

_N = 28.25
_n = _N / 1.68
MOTOR_OF_JOINT = np.array(  # motor speeds = MOTOR_OF_JOINT @ joint speeds, libbarrett's j2mp
    [
        [-42.0, 0, 0, 0, 0, 0, 0],
        [0, _N, -_n, 0, 0, 0, 0],
        [0, -_N, -_n, 0, 0, 0, 0],
        [0, 0, 0, -18.0, 0, 0, 0],
        [0, 0, 0, 0, 9.7, -9.7, 0],
        [0, 0, 0, 0, 9.7, 9.7, 0],
        [0, 0, 0, 0, 0, 0, -14.93],
    ]
)
TORQUE_CONSTANT = np.array([0.457] * 4 + [0.236] * 2 + [0.067])  # [N m/A] = [V s/rad]
RESISTANCE = np.array([3.473] * 4 + [6.213] * 2 + [5.205])  # [ohm]
CABLE_LIMIT = np.array([1.8, 1.8, 1.8, 1.6, 0.6, 0.6, 0.0916])  # [N m] at the motor
NO_LOAD_SPEED_48V = np.array([100.218] * 4 + [192.309] * 2 + [569.022])  # [rad/s] of the motor


class Motors:
    """The envelope at one bus voltage.

    Attributes:
        no_load_speed: of each joint moving alone [rad/s]. Shape (7,).
    """

    def __init__(self, bus_voltage: float) -> None:
        """Motors on `bus_voltage` [V]; the arm allows 36 to 90 V."""
        if not 36.0 <= bus_voltage <= 90.0:
            raise ValueError(f"bus_voltage {bus_voltage} V is outside the arm's 36 to 90 V")
        speed = NO_LOAD_SPEED_48V * bus_voltage / 48.0
        self.no_load_speed = np.min(
            np.where(
                MOTOR_OF_JOINT != 0.0,
                speed[:, None] / np.abs(np.where(MOTOR_OF_JOINT == 0, 1, MOTOR_OF_JOINT)),
                np.inf,
            ),
            axis=0,
        )
        self._stall = TORQUE_CONSTANT * bus_voltage / RESISTANCE
        self._slope = self._stall / speed  # [N m s/rad]: zero torque at the no-load speed
        self._to_motor = np.linalg.inv(MOTOR_OF_JOINT).T.copy()
        self._to_joint = MOTOR_OF_JOINT.T.copy()
        self._braking = MOTOR_OF_JOINT.T @ np.diag(TORQUE_CONSTANT**2 / RESISTANCE) @ MOTOR_OF_JOINT

    def limit(self, tau: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """What the motors make of wanted joint torques `tau` (7,) [N m] at speeds `qd` (7,)."""
        wanted = self._to_motor @ tau
        back = self._slope * (MOTOR_OF_JOINT @ qd)
        upper = np.minimum(self._stall - back, CABLE_LIMIT)
        lower = np.maximum(-self._stall - back, -CABLE_LIMIT)
        given = np.minimum(np.maximum(wanted, lower), upper)
        if (given == wanted).all():
            return tau
        return self._to_joint @ given

    def braking(self, qd: np.ndarray) -> np.ndarray:
        """Torque of shorted motors (the arm's IDLE), (7,) [N m]."""
        return -self._braking @ qd
