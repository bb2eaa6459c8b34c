# SPDX-License-Identifier: Apache-2.0
"""Consistency of the WAM's data with each other and with its URDF."""

from __future__ import annotations

import numpy as np
from simulated import URDF

from hardware_sim import wam
from wam_power_ros.control.arm import Arm


def test_the_folded_posture_is_within_the_limits_of_the_joints_in_the_urdf() -> None:
    arm = Arm(URDF, wam.JOINTS)
    assert arm.n == wam.N
    assert ((arm.q_min < wam.FOLDED) & (wam.FOLDED < arm.q_max)).all()


def test_a_motor_turns_at_most_as_fast_as_the_bus_voltage_balances_its_back_emf() -> None:
    ideal = 48.0 / wam.TORQUE_CONSTANT
    assert (wam.NO_LOAD_SPEED_48V < ideal).all()
    assert (wam.NO_LOAD_SPEED_48V > 0.75 * ideal).all()


def test_position_control_asks_for_no_torque_that_the_cables_cannot_carry() -> None:
    carried = wam.CABLE_LIMIT @ np.abs(wam.MOTOR_OF_JOINT)
    assert (wam.POSITION_TAU_MAX[:6] < carried[:6]).all()


def test_the_watchdog_waits_for_10_ms() -> None:
    assert wam.WATCHDOG_TIMEOUT == 0.01
    assert wam.PERIOD == 0.002
