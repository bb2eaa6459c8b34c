# SPDX-License-Identifier: Apache-2.0
"""A driver of 1000 states a second is judged in the same times as one of 500."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from rigid_arm import HOME as Q
from rigid_arm import MODEL as ARM

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Speeds
from wam_power_ros.control.modes import Mode
from wam_power_ros.control.plausibility import Bound, Interval, TorqueCheck, VelocityCheck
from wam_power_ros.control.state_checks import JointState, at_rate

STILL = np.zeros(7)
PERIODS = (0.002, 0.001)  # [s]


def states_until(found: Callable[[int], bool]) -> int:
    """Number of states, from 1 on, with which something is found."""
    return next(count for count in range(1, 1000) if found(count))


def too_fast(period: float) -> int:
    check = safety.MotionCheck(safety.limits_of(ARM), ARM.guarded, period)
    state, fast = JointState(0, Q, STILL, period, period), Speeds([0.0, 0.0], 50.0)
    return states_until(lambda _: check.fault(Mode.HOLD, state, fast) is not None)


def frozen(period: float) -> int:
    """States of a joint that reports 0.1 rad/s, and the same position for ever."""
    check, moving = VelocityCheck(7, period), np.array([0.1, *STILL[1:]])
    state, interval = JointState(0, Q, moving, period, period), Interval(period, period, period)
    return states_until(lambda n: check.fault(state, state, [n] * 7, interval) is not None)


def pushed(period: float) -> int:
    """States of an arm at rest under a torque that gravity does not need."""
    check, bound = TorqueCheck(ARM, period), Bound(np.full(7, 1.0), np.full(7, 1.0))
    state, tau = JointState(0, Q, STILL, period, period), ARM.gravity(Q) + 60.0
    unchanged = [0] * 7
    return states_until(lambda _: bool(check.fault(state, state, unchanged, tau, bound, period)))


@pytest.mark.parametrize("judged", [too_fast, frozen, pushed])
def test_a_fault_is_found_after_the_same_time_at_both_rates(judged: Callable[[float], int]) -> None:
    slow, quick = (judged(period) * period for period in PERIODS)
    assert abs(slow - quick) <= 0.001 + 1e-9


def test_a_slower_driver_gets_no_fewer_states_to_judge_by() -> None:
    assert [at_rate(3, period) for period in (0.005, 0.002, 0.001)] == [3, 3, 6]
