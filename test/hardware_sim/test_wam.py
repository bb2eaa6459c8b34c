# SPDX-License-Identifier: Apache-2.0
"""Consistency of the WAM's data with each other and with its URDF."""

from __future__ import annotations

from hardware_sim import wam


def test_a_motor_turns_at_most_as_fast_as_the_bus_voltage_balances_its_back_emf() -> None:
    ideal = 48.0 / wam.TORQUE_CONSTANT
    assert (wam.NO_LOAD_SPEED_48V < ideal).all()
    assert (wam.NO_LOAD_SPEED_48V > 0.75 * ideal).all()


def test_the_watchdog_waits_for_10_ms() -> None:
    assert wam.WATCHDOG_TIMEOUT == 0.01
    assert wam.PERIOD == 0.002
