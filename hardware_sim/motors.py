# SPDX-License-Identifier: Apache-2.0
"""Torque limits of the motors: cable limits and the torque-speed envelope at a bus voltage.

Joints 2-3 and 5-6 each share two motors through a differential, so the limits apply to motors, and
the limit of a joint depends on the torque of its neighbour. Plain floats, not arrays: several times
faster for seven numbers, 500 times a second.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hardware_sim.wam import (
    BUS_VOLTAGE_MAX,
    BUS_VOLTAGE_MIN,
    CABLE_LIMIT,
    J1,
    J2,
    J3,
    J4,
    J7,
    J56,
    MOTOR_OF_JOINT,
    NO_LOAD_SPEED_48V,
    RESISTANCE,
    TORQUE_CONSTANT,
)

# Upper bound of the full-torque speed, as a share of the no-load speed: motor 7 has drag.
_FULL_TORQUE_SHARE = 0.9


def motor_motion(joints: Sequence[float]) -> tuple[float, ...]:
    """Motor positions [rad] or speeds [rad/s] of joint positions or speeds; seven each."""
    q1, q2, q3, q4, q5, q6, q7 = joints
    a, b, c, d = J2 * q2, J3 * q3, J56 * q5, J56 * q6
    return J1 * q1, a - b, -a - b, J4 * q4, c - d, c + d, J7 * q7


def joint_motion(motors: Sequence[float]) -> tuple[float, ...]:
    """Joint positions [rad] or speeds [rad/s] of motor ones; inverse of `motor_motion`."""
    m1, m2, m3, m4, m5, m6, m7 = motors
    a, b, c, d = (m2 - m3) / (2.0 * J2), (m2 + m3) / (-2.0 * J3), m6 + m5, m6 - m5
    return m1 / J1, a, b, m4 / J4, c / (2.0 * J56), d / (2.0 * J56), m7 / J7


def _motor_torques(joints: Sequence[float]) -> tuple[float, ...]:
    """Motor torques of joint torques; seven each [N m]."""
    t1, t2, t3, t4, t5, t6, t7 = joints
    a, b, c, d = t2 / (2.0 * J2), t3 / (2.0 * J3), t5 / (2.0 * J56), t6 / (2.0 * J56)
    return t1 / J1, a - b, -a - b, t4 / J4, c - d, c + d, t7 / J7


def _joint_torques(motors: Sequence[float]) -> tuple[float, ...]:
    """Joint torques of motor torques; inverse of `_motor_torques`."""
    m1, m2, m3, m4, m5, m6, m7 = motors
    a, b, c, d = J2 * (m2 - m3), -J3 * (m2 + m3), J56 * (m5 + m6), J56 * (m6 - m5)
    return J1 * m1, a, b, J4 * m4, c, d, J7 * m7


class DirectDrives:
    """One motor per joint with torque and speed limits of the URDF; for other arms than the WAM.

    Limits are tau_max (n,) [N m] and qd_max (n,) [rad/s]; attributes are those of `Motors`.
    """

    def __init__(self, tau_max: np.ndarray, qd_max: np.ndarray) -> None:
        self.motor_of_joint = np.eye(len(tau_max))
        self.motor_no_load_speed = qd_max.copy()
        self._limits = np.stack([tau_max, qd_max], axis=1).tolist()

    def limit(self, tau: Sequence[float], qd: Sequence[float]) -> Sequence[float]:
        """See `Motors.limit`: beyond its speed limit a motor only brakes."""
        given = []
        for torque, speed, (peak, speed_max) in zip(tau, qd, self._limits, strict=True):
            most = 0.0 if speed > speed_max else peak
            least = 0.0 if speed < -speed_max else -peak
            given.append(max(least, min(most, torque)))
        return tau if given == list(tau) else given

    def braking(self, qd: Sequence[float]) -> Sequence[float]:
        """See `Motors.braking`: proportional to speed, full torque at the speed limit."""
        rows = zip(qd, self._limits, strict=True)
        return [-peak / speed_max * speed for speed, (peak, speed_max) in rows]


class Motors:
    """Torque-speed envelope of the WAM's motors at one bus voltage.

    A motor gives full torque up to the speed at which the voltage minus the back-EMF still drives
    the required current; above it the torque falls linearly, to zero at the no-load speed, and
    beyond that the motor brakes. Against its motion it gives full torque at any speed.

    Attributes:
        motor_of_joint: Matrix from joint speeds to motor speeds. Shape (7, 7).
        motor_no_load_speed: No-load speed of each motor [rad/s]. Shape (7,).
        motor_full_torque_speed: Speed up to which it has full torque [rad/s]. Shape (7,).

    Raises:
        ValueError: The bus voltage is not 36 to 90 V.
    """

    motor_of_joint = MOTOR_OF_JOINT

    def __init__(self, bus_voltage: float = 48.0) -> None:
        if not BUS_VOLTAGE_MIN <= bus_voltage <= BUS_VOLTAGE_MAX:
            allowed = f"{BUS_VOLTAGE_MIN:.0f} to {BUS_VOLTAGE_MAX:.0f} V"
            raise ValueError(f"bus_voltage {bus_voltage} V is outside the arm's {allowed}")
        self.motor_no_load_speed = no_load = NO_LOAD_SPEED_48V * bus_voltage / 48.0
        current = CABLE_LIMIT / TORQUE_CONSTANT
        full = (bus_voltage - current * RESISTANCE) / TORQUE_CONSTANT
        self.motor_full_torque_speed = full = np.minimum(full, _FULL_TORQUE_SHARE * no_load)
        slope = CABLE_LIMIT / (no_load - full)  # [N m s/rad]
        self._envelope = np.stack([CABLE_LIMIT, no_load, slope], axis=1).tolist()
        self._brake = (TORQUE_CONSTANT**2 / RESISTANCE).tolist()

    def limit(self, tau: Sequence[float], qd: Sequence[float]) -> Sequence[float]:
        """Limit joint torques [N m] at joint speeds [rad/s]; seven each.

        Returns `tau` itself if no motor is at a limit.
        """
        wanted, given, within = _motor_torques(tau), [], True
        rows = zip(wanted, motor_motion(qd), self._envelope, strict=True)
        for torque, speed, (peak, no_load, slope) in rows:
            most, least = slope * (no_load - speed), -slope * (no_load + speed)
            if most < torque or peak < torque:
                torque = min(peak, max(most, -peak))
                within = False
            elif torque < least or torque < -peak:
                torque = max(-peak, min(least, peak))
                within = False
            given.append(torque)
        return tau if within else _joint_torques(given)

    def braking(self, qd: Sequence[float]) -> Sequence[float]:
        """Joint torques [N m] of shorted motors at joint speeds [rad/s]: the arm in IDLE."""
        rows = zip(self._brake, motor_motion(qd), strict=True)
        return _joint_torques([-k * speed for k, speed in rows])
