# SPDX-License-Identifier: Apache-2.0
"""Torques sent to the driver for a motor torque."""

from collections import Counter

import numpy as np
import pytest
from rigid_arm import HOME, LIMITS, MODEL

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
