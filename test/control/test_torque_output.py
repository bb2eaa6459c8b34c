# SPDX-License-Identifier: Apache-2.0
"""Torques sent to the driver for a motor torque."""

import dataclasses
from collections import Counter

import numpy as np
import pytest
from rigid_arm import A_TEST, HOME, LIMITS, MODEL, begin, make, run

from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.torque_output import TorqueOutput

GRAVITY = MODEL.gravity(HOME)


@pytest.mark.requirement("S-04")
def test_the_motors_of_a_driver_that_adds_gravity_stay_within_their_limit() -> None:
    out = TorqueOutput(MODEL, LIMITS, True, Counter())
    out.send(GRAVITY + 0.5, HOME, None)
    np.testing.assert_allclose(out.motor_torque(HOME), GRAVITY + 0.5, atol=1e-12)
    beyond = 10.0 * LIMITS.torque * np.sign(GRAVITY + 1e-9)
    for dt in (None, 1.0, 1.0):
        out.send(beyond, HOME, dt)
        assert np.all(np.abs(out.motor_torque(HOME)) <= LIMITS.torque + 1e-9)


@pytest.mark.requirement("S-04")
def test_a_share_of_the_limits_never_turns_against_the_gravity_that_a_driver_adds() -> None:
    """An arm that weighs more than the share would be pushed down, the more the further it is."""
    share = 0.5 * np.maximum(np.abs(GRAVITY), 0.1)
    limits = dataclasses.replace(LIMITS, torque=share)
    out = TorqueOutput(MODEL, limits, True, Counter())
    np.testing.assert_allclose(out.send(GRAVITY, HOME, None), 0.0, atol=1e-12)
    up = np.sign(GRAVITY) * share
    np.testing.assert_allclose(out.send(GRAVITY + 2.0 * up, HOME, None), up, atol=1e-12)


@pytest.mark.requirement("S-122")
def test_an_arm_that_weighs_more_than_the_share_is_held_after_a_fault() -> None:
    torque = 0.5 * np.maximum(np.abs(GRAVITY), 2.0)
    limits = dataclasses.replace(LIMITS, torque=torque)
    controller = make(limits=limits, driver_compensates_gravity=True)
    controller, plant = begin(controller=controller, adds_gravity=True, friction=0.5)
    plant.qd = plant.qd + 0.1 * np.eye(MODEL.n)[1]
    run(controller, plant, 0.02)
    controller.fault(A_TEST)
    run(controller, plant, 1.5)
    assert np.abs(plant.qd).max() < 0.01
    assert np.abs(plant.q - HOME).max() < 0.05


@pytest.mark.requirement("S-04")
def test_an_arm_is_taken_over_only_where_what_may_be_sent_carries_it() -> None:
    limits = dataclasses.replace(LIMITS, torque=0.9 * np.maximum(np.abs(GRAVITY), 2.0))
    for adds_gravity in (False, True):
        for latched in (None, A_TEST):
            settings = ControllerSettings(limits=limits, driver_compensates_gravity=adds_gravity)
            controller = Controller(MODEL, settings, latched)
            for k in range(800):  # on a table, or held by the driver
                controller.step(k * 2_000_000, HOME, np.zeros(MODEL.n))
            request = controller.hold if latched is None else controller.reset
            if adds_gravity:
                request()
                assert controller.mode is Mode.HOLD
                controller.stop()
            else:
                with pytest.raises(ControllerError, match=r"j2 needs 17\.\d N m .* are 16\.\d"):
                    request()
                assert controller.mode is not Mode.HOLD


def test_the_torque_rate_is_limited_and_counted_but_not_while_inactive() -> None:
    counters: Counter[str] = Counter()
    out = TorqueOutput(MODEL, LIMITS, False, counters)
    most = 0.002 * LIMITS.torque_rate
    first = out.send(3.0 * most, HOME, None)
    np.testing.assert_array_equal(first, np.minimum(3.0 * most, LIMITS.torque))
    assert not counters
    second = out.send(np.zeros(MODEL.n), HOME, 0.002)
    np.testing.assert_allclose(second, np.maximum(first - most, 0.0), atol=1e-12)
    assert counters["limited"] == 1
    with pytest.raises(ValueError, match="read-only"):
        second[0] = 9.0
