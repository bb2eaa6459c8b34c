# SPDX-License-Identifier: Apache-2.0
"""The torque-speed envelope of the motors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hardware_sim.motors import DirectDrives, Motors
from hardware_sim.wam import CABLE_LIMIT, MOTOR_OF_JOINT

RATIO = np.abs(MOTOR_OF_JOINT).max(axis=0)  # (joint,) of a joint that moves alone
TAU_MAX = CABLE_LIMIT @ np.abs(MOTOR_OF_JOINT)  # [N m] of a joint alone


torques = arrays(float, 7, elements=st.floats(-200.0, 200.0))
speeds = arrays(float, 7, elements=st.floats(-30.0, 30.0))


@settings(max_examples=80)
@given(torques, speeds, st.sampled_from([36.0, 48.0, 80.0]))
def test_motor_torques_are_cut_at_the_envelope_and_unchanged_within(
    tau: np.ndarray, qd: np.ndarray, voltage: float
) -> None:
    motors = Motors(voltage)
    given_tau = np.array(motors.limit(tau.tolist(), qd.tolist()))
    to_motor = np.linalg.inv(MOTOR_OF_JOINT).T
    wanted, got, speed = to_motor @ tau, to_motor @ given_tau, MOTOR_OF_JOINT @ qd
    assert (np.abs(got) <= CABLE_LIMIT * (1.0 + 1e-9)).all()
    driven = got * speed > 0.0
    over = np.abs(speed) >= motors.motor_no_load_speed
    assert (np.abs(got[driven & over]) < 1e-9).all()  # no driving torque beyond the no-load speed
    braking = wanted * speed <= 0.0
    full = np.abs(wanted) <= CABLE_LIMIT
    np.testing.assert_allclose(
        got[braking & full & ~over], wanted[braking & full & ~over], atol=1e-9
    )
    again = np.array(motors.limit(given_tau.tolist(), qd.tolist()))
    np.testing.assert_allclose(again, given_tau, atol=1e-9)


@pytest.mark.parametrize("joint", [0, 3, 6])
def test_torque_is_full_up_to_a_speed_and_zero_at_no_load(joint: int) -> None:
    motors = Motors(48.0)
    one = np.eye(7)[joint]

    def given_at(speed: float) -> float:
        return float(motors.limit(list(1e3 * one), list(speed * one))[joint])

    full = (motors.motor_full_torque_speed / RATIO)[joint]
    no_load = (motors.motor_no_load_speed / RATIO)[joint]
    # Barrett's data: J4 has 28.8 N m up to 4.36 rad/s and a no-load speed of 5.57 rad/s
    assert given_at(0.0) == pytest.approx(TAU_MAX[joint])
    assert given_at(full) == pytest.approx(TAU_MAX[joint])
    assert given_at(0.5 * (full + no_load)) == pytest.approx(0.5 * TAU_MAX[joint])
    assert given_at(no_load) == pytest.approx(0.0, abs=1e-9)
    assert given_at(-no_load) == pytest.approx(TAU_MAX[joint])  # braking


def test_the_envelope_is_that_of_the_facts_sheet() -> None:
    motors = Motors(48.0)
    no_load = [2.39, 3.55, 5.96, 5.57, 19.8, 19.8, 38.1]
    full = [1.79, 2.66, 4.47, 4.36, 14.1, 14.1, 34.5]
    np.testing.assert_allclose(motors.motor_no_load_speed / RATIO, no_load, rtol=5e-3)
    np.testing.assert_allclose(motors.motor_full_torque_speed / RATIO, full, rtol=1e-2)
    faster = Motors(80.0).motor_no_load_speed / motors.motor_no_load_speed
    np.testing.assert_allclose(faster, 80 / 48)


def test_a_bus_voltage_out_of_range_is_refused() -> None:
    for voltage in (20.0, 100.0, math.nan):
        with pytest.raises(ValueError, match="36 to 90 V"):
            Motors(voltage)


speeds_of_direct = arrays(float, 7, elements=st.floats(-5.0, 5.0))


@settings(max_examples=50)
@given(torques, speeds_of_direct)
def test_a_direct_drive_gives_the_urdfs_torque_up_to_the_urdfs_speed_and_only_brakes_beyond(
    tau: np.ndarray, qd: np.ndarray
) -> None:
    tau_max, qd_max = np.full(7, 50.0), np.full(7, 2.0)
    drives = DirectDrives(tau_max, qd_max)
    got = np.array(drives.limit(tau.tolist(), qd.tolist()))
    assert (np.abs(got) <= tau_max).all()
    beyond = np.abs(qd) > qd_max
    assert (got[beyond] * qd[beyond] <= 0.0).all()
    free = ~beyond | (tau * qd <= 0.0)
    np.testing.assert_array_equal(got[free], np.clip(tau, -tau_max, tau_max)[free])
    np.testing.assert_allclose(drives.braking(qd.tolist()), -25.0 * qd, atol=1e-12)
