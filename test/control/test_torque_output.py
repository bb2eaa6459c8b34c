# SPDX-License-Identifier: Apache-2.0
"""Torques sent to the driver for a motor torque."""

from collections import Counter

import numpy as np
import pytest
from rigid_arm import HOME, LIMITS, MODEL

from wam_power_ros.control.torque_output import TorqueOutput

GRAVITY = MODEL.gravity(HOME)


def output(compensated: bool = False) -> TorqueOutput:
    return TorqueOutput(MODEL, LIMITS, compensated, Counter())


@pytest.mark.parametrize("compensated", [False, True])
def test_the_motor_torque_is_as_requested_whether_or_not_the_driver_adds_gravity(
    compensated: bool,
) -> None:
    out = output(compensated)
    wanted = GRAVITY + 0.5
    out.send(wanted, HOME, None)
    np.testing.assert_allclose(out.motor_torque(HOME), wanted, atol=1e-12)


@pytest.mark.requirement("S-04")
def test_the_motors_of_a_driver_that_adds_gravity_stay_within_their_limit() -> None:
    out = output(compensated=True)
    beyond = 10.0 * LIMITS.torque * np.sign(GRAVITY + 1e-9)
    for dt in (None, 1.0, 1.0):
        out.send(beyond, HOME, dt)
        assert np.all(np.abs(out.motor_torque(HOME)) <= LIMITS.torque + 1e-9)


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


def test_a_torque_that_was_sent_cannot_be_changed_afterwards() -> None:
    out = output()
    with pytest.raises(ValueError, match="read-only"):
        out.send(GRAVITY, HOME, 0.002)[0] = 9.0
