# SPDX-License-Identifier: Apache-2.0
"""Data of the Barrett WAM 7-DOF that are not in its URDF."""

import numpy as np

N = 7  # number of joints
JOINTS = tuple(f"wam_j{number}" for number in range(1, N + 1))

# Control period and watchdog of the driver
PERIOD_NS = 2_000_000  # [ns]
PERIOD = PERIOD_NS / 1e9  # [s]
WATCHDOG_TIMEOUT = 0.01  # [s] without a command
WATCHDOG_DAMPING = 5.0  # [1/s] of the gravity compensation that then begins

# Transmission: motor turns per joint turn, libbarrett's j2mp; 2-3 and 5-6 are differentials
J1, J2, J3, J4, J56, J7 = -42.0, 28.25, 28.25 / 1.68, -18.0, 9.7, -14.93
MOTOR_OF_JOINT = np.array(  # motor speeds = MOTOR_OF_JOINT @ joint speeds
    [
        [J1, 0, 0, 0, 0, 0, 0],
        [0, J2, -J3, 0, 0, 0, 0],
        [0, -J2, -J3, 0, 0, 0, 0],
        [0, 0, 0, J4, 0, 0, 0],
        [0, 0, 0, 0, J56, -J56, 0],
        [0, 0, 0, 0, J56, J56, 0],
        [0, 0, 0, 0, 0, 0, J7],
    ]
)

# Motors
TORQUE_CONSTANT = np.array([0.457] * 4 + [0.236] * 2 + [0.067])  # [N m/A] = [V s/rad]
RESISTANCE = np.array([3.473] * 4 + [6.213] * 2 + [5.205])  # [ohm]
CABLE_LIMIT = np.array([1.8, 1.8, 1.8, 1.6, 0.6, 0.6, 0.0916])  # [N m] at the motor
NO_LOAD_SPEED_48V = np.array([100.218] * 4 + [192.309] * 2 + [569.022])  # [rad/s] of the motor
BUS_VOLTAGE_MIN, BUS_VOLTAGE_MAX = 36.0, 90.0  # [V]

# Encoders, and libbarrett's low-pass of the velocity
ENCODER_COUNTS = 4096  # per turn of a motor
VELOCITY_CUTOFF = 180.0  # [rad/s]
