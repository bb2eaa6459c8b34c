# SPDX-License-Identifier: Apache-2.0
"""What the WAM's motors can give: cable limits and the torque-speed envelope of a bus voltage.

Joints 2-3 and 5-6 share two motors each through differentials, so limits hold for motors, and a
joint's limit depends on what its neighbour asks. Plain floats, not arrays: for seven numbers, 500
times a second, that is several times faster.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# Motor over joint positions, libbarrett's j2mp
_1, _2, _3, _4, _56, _7 = -42.0, 28.25, 28.25 / 1.68, -18.0, 9.7, -14.93
MOTOR_OF_JOINT = np.array(  # motor speeds = MOTOR_OF_JOINT @ joint speeds
    [
        [_1, 0, 0, 0, 0, 0, 0],
        [0, _2, -_3, 0, 0, 0, 0],
        [0, -_2, -_3, 0, 0, 0, 0],
        [0, 0, 0, _4, 0, 0, 0],
        [0, 0, 0, 0, _56, -_56, 0],
        [0, 0, 0, 0, _56, _56, 0],
        [0, 0, 0, 0, 0, 0, _7],
    ]
)
TORQUE_CONSTANT = np.array([0.457] * 4 + [0.236] * 2 + [0.067])  # [N m/A] = [V s/rad]
RESISTANCE = np.array([3.473] * 4 + [6.213] * 2 + [5.205])  # [ohm]
CABLE_LIMIT = np.array([1.8, 1.8, 1.8, 1.6, 0.6, 0.6, 0.0916])  # [N m] at the motor
NO_LOAD_SPEED_48V = np.array([100.218] * 4 + [192.309] * 2 + [569.022])  # [rad/s] of the motor
_FULL_TORQUE_AT_MOST = 0.9  # of the no-load speed: motor 7 is held back by its own drag


def motor_motion(joints: Sequence[float]) -> tuple[float, ...]:
    """Positions or speeds of the motors for those of the joints; seven each [rad] or [rad/s]."""
    q1, q2, q3, q4, q5, q6, q7 = joints
    a, b, c, d = _2 * q2, _3 * q3, _56 * q5, _56 * q6
    return _1 * q1, a - b, -a - b, _4 * q4, c - d, c + d, _7 * q7


def joint_motion(motors: Sequence[float]) -> tuple[float, ...]:
    """Positions or speeds of the joints for those of the motors: `motor_motion` backwards."""
    m1, m2, m3, m4, m5, m6, m7 = motors
    return (
        m1 / _1,
        (m2 - m3) / (2.0 * _2),
        (m2 + m3) / (-2.0 * _3),
        m4 / _4,
        (m6 + m5) / (2.0 * _56),
        (m6 - m5) / (2.0 * _56),
        m7 / _7,
    )


class DirectDrives:
    """A motor on every joint that gives the URDF's torque up to the URDF's speed: another arm's.

    Attributes:
        of_joints: Motor speeds over joint speeds. Shape (7, 7).
        motor_no_load_speed: [rad/s]. Shape (7,).

    Args:
        tau_max: [N m]. Shape (7,).
        qd_max: [rad/s]. Shape (7,).
    """

    def __init__(self, tau_max: np.ndarray, qd_max: np.ndarray) -> None:
        self.of_joints = np.eye(len(tau_max))
        self.motor_no_load_speed = qd_max.copy()
        self._rows = np.stack([tau_max, qd_max], axis=1).tolist()

    def limit(self, tau: Sequence[float], qd: Sequence[float]) -> Sequence[float]:
        """See `Motors`: beyond its speed a motor only brakes."""
        given = []
        for torque, speed, (peak, fastest) in zip(tau, qd, self._rows, strict=True):
            most = 0.0 if speed > fastest else peak
            least = 0.0 if speed < -fastest else -peak
            given.append(max(least, min(most, torque)))
        return tau if given == list(tau) else given

    def braking(self, qd: Sequence[float]) -> Sequence[float]:
        """See `Motors`: full torque at full speed, in proportion below."""
        return [
            -peak / fastest * speed for speed, (peak, fastest) in zip(qd, self._rows, strict=True)
        ]


class Motors:
    """The envelope of the WAM's at one bus voltage.

    A motor gives its full torque up to the speed at which the voltage less the back-EMF still
    drives the current for it; from there the torque falls linearly, to zero at the no-load speed,
    and beyond that the motor brakes. Against its motion it gives full torque at any speed.

    Attributes:
        of_joints: Motor speeds over joint speeds. Shape (7, 7).
        motor_no_load_speed: Of each motor [rad/s]. Shape (7,).
        no_load_speed: Of each joint moving alone [rad/s]. Shape (7,).
        full_torque_speed: Of each joint moving alone, up to which it has full torque [rad/s].
            Shape (7,).
        tau_max: Full torque of each joint alone [N m]. Shape (7,).

    Args:
        bus_voltage: The arm is made for 48 V and allows 36 to 90 V.

    Raises:
        ValueError: The voltage is outside that.
    """

    def __init__(self, bus_voltage: float = 48.0) -> None:
        if not 36.0 <= bus_voltage <= 90.0:
            raise ValueError(f"bus_voltage {bus_voltage} V is outside the arm's 36 to 90 V")
        no_load = NO_LOAD_SPEED_48V * bus_voltage / 48.0
        current = CABLE_LIMIT / TORQUE_CONSTANT
        full = (bus_voltage - current * RESISTANCE) / TORQUE_CONSTANT
        full = np.minimum(full, _FULL_TORQUE_AT_MOST * no_load)
        ratio = np.abs(MOTOR_OF_JOINT).max(axis=0)  # (joint,)
        self.of_joints = MOTOR_OF_JOINT
        self.motor_no_load_speed = no_load
        self.no_load_speed = no_load / ratio
        self.full_torque_speed = full / ratio
        self.tau_max = CABLE_LIMIT @ np.abs(MOTOR_OF_JOINT)
        slope = CABLE_LIMIT / (no_load - full)  # [N m s/rad]
        self._envelope = np.stack([CABLE_LIMIT, no_load, slope], axis=1).tolist()
        self._full = np.stack([CABLE_LIMIT, full], axis=1).tolist()  # nothing is cut within these
        self._brake = (TORQUE_CONSTANT**2 / RESISTANCE).tolist()

    def limit(self, tau: Sequence[float], qd: Sequence[float]) -> Sequence[float]:
        """What the motors make of wanted joint torques at these joint speeds.

        Args:
            tau: [N m]; seven.
            qd: [rad/s]; seven.

        Returns:
            [N m]; `tau` itself when no motor is at a limit.
        """
        t1, t2, t3, t4, t5, t6, t7 = tau
        a, b, c, d = t2 / (2.0 * _2), t3 / (2.0 * _3), t5 / (2.0 * _56), t6 / (2.0 * _56)
        wanted = (t1 / _1, a - b, -a - b, t4 / _4, c - d, c + d, t7 / _7)
        speeds = motor_motion(qd)
        for torque, speed, (peak, full) in zip(wanted, speeds, self._full, strict=True):
            if not (-peak <= torque <= peak and -full <= speed <= full):
                break
        else:
            return tau
        given = []
        within = True
        for torque, speed, (peak, no_load, slope) in zip(
            wanted, speeds, self._envelope, strict=True
        ):
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
        """Torques of shorted motors, the arm's IDLE.

        Args:
            qd: [rad/s]; seven.

        Returns:
            [N m]; seven.
        """
        return _joint_torques(
            [-k * speed for k, speed in zip(self._brake, motor_motion(qd), strict=True)]
        )


def _joint_torques(motors: Sequence[float]) -> tuple[float, ...]:
    m1, m2, m3, m4, m5, m6, m7 = motors
    return (
        _1 * m1,
        _2 * (m2 - m3),
        -_3 * (m2 + m3),
        _4 * m4,
        _56 * (m5 + m6),
        _56 * (m6 - m5),
        _7 * m7,
    )
