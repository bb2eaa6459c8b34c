# SPDX-License-Identifier: Apache-2.0
"""Checks of stamps, values and continuity of joint states."""

import math

import numpy as np
import pytest
from rigid_arm import HOME as Q

from wam_power_ros.control.state_checks import (
    IMPLAUSIBLE_Q,
    IMPLAUSIBLE_QD,
    JointState,
    StateChecks,
    plausible,
)
from wam_power_ros.faults import FaultKind

MS = 1_000_000
ZERO = np.zeros(7)


def checks() -> StateChecks:
    """Checks that have accepted one state, of stamp 0."""
    states = StateChecks(7, 0.002, 180.0, np.full(7, 100.0))
    assert isinstance(states.take(0, Q, ZERO, restart=False), JointState)
    return states


@pytest.mark.parametrize(
    ("stamp", "q", "qd"),
    [
        (2.0, Q, ZERO),
        (-1, Q, ZERO),
        (2 * MS, Q, ZERO[:6]),
        (2 * MS, Q * math.nan, ZERO),
        (2 * MS, Q, ZERO + math.inf),
        (2 * MS, [[1.0], [2.0, 3.0]], ZERO),
    ],
)
def test_an_invalid_state_is_refused_as_a_whole(stamp: object, q: object, qd: object) -> None:
    states = checks()
    assert states.take(stamp, q, qd, restart=False) is None
    assert (states.last.stamp_ns, states.refused_in_row, states.fault) == (0, 1, None)
    assert np.array_equal(states.last.q, Q) and np.array_equal(states.last.qd, ZERO)
    assert states.counters["older" if stamp == -1 else "rejected"] == 1
    later = Q.copy()
    assert isinstance(states.take(2 * MS, later, ZERO, restart=False), JointState)
    later[0] = 9.0  # a state is a copy
    assert states.refused_in_row == 0 and np.array_equal(states.last.q, Q)


def test_an_older_stamp_is_a_restart_where_restarts_are_allowed() -> None:
    states = checks()
    states.take(10 * MS, Q, ZERO, restart=False)
    assert isinstance(states.take(2 * MS, Q + 1.0, ZERO, restart=True), JointState)
    assert states.last.stamp_ns == 2 * MS and states.fault is None  # nothing is compared across it
    assert states.last.dt == 0.002


def interleaved(states: StateChecks, restart: bool, n: int = 100) -> list[bool]:
    """Which states of a relay were accepted that repeats those of a driver 6 ms late."""
    accepted = []
    begin = states.last.stamp_ns // (2 * MS) + 4
    for k in range(begin, begin + n):
        assert states.take(k * 2 * MS, Q, ZERO, restart=restart) is not None
        accepted.append(states.take((k - 3) * 2 * MS + 1, Q, ZERO, restart=restart) is not None)
    return accepted


@pytest.mark.requirement("S-130")
def test_stamps_that_go_back_again_and_again_are_no_restart() -> None:
    states = checks()
    assert interleaved(states, restart=True, n=600) == [True] + [False] * 599
    assert states.counters["older"] == 599


@pytest.mark.requirement("S-130")
def test_stamps_that_went_back_before_a_fault_go_back_again_in_it() -> None:
    states = checks()
    assert not any(interleaved(states, restart=False, n=5))
    assert states.fault.kind is FaultKind.STATES_REFUSED
    assert not any(interleaved(states, restart=True))


@pytest.mark.requirement("S-130")
@pytest.mark.parametrize("late", [False, True])
def test_a_driver_that_restarts_is_used_again_within_a_second(late: bool) -> None:
    states = checks()
    states.take(10**9, Q, ZERO, restart=False)
    if late:  # a state of the old driver arrives after the first of the new one
        states.take(MS, Q, ZERO, restart=True)
        states.take(10**9 + 2 * MS, Q, ZERO, restart=True)
    taken = [states.take(k * 2 * MS, Q, ZERO, restart=True) is not None for k in range(1, 601)]
    assert taken == [not late or k >= 498 for k in range(600)]


@pytest.mark.requirement("S-11")
@pytest.mark.parametrize(
    ("q", "qd", "reason"),
    [
        (np.rad2deg(Q), None, "position of joint 4 is 115, allowed is 20 rad: degrees?"),
        (Q, ZERO - 1e3, "velocity of joint 1 is -1e+03, allowed is 500 rad/s"),
        (Q[:6], ZERO, "position has shape (6,), the arm 7 joints"),
        (Q, "still", "could not convert string to float: 'still'"),
    ],
)
def test_a_refused_state_says_why(q: object, qd: object, reason: str) -> None:
    states = StateChecks(7, 0.002, 180.0, np.full(7, 100.0))
    assert states.refusal == ""
    assert states.take(0, q, qd, restart=False) is None
    assert states.refusal == reason


@pytest.mark.requirement("S-42")
def test_a_gap_is_counted_and_a_long_one_a_fault() -> None:
    for stamp, gaps, kind in (
        (1, 0, None),
        (6 * MS, 0, None),
        (6 * MS + 1, 1, None),
        (20 * MS, 1, None),
        (21 * MS, 1, FaultKind.STATES_LOST),
    ):
        states = checks()
        assert isinstance(states.take(stamp, Q, ZERO, restart=False), JointState)
        assert states.counters["gaps"] == gaps
        assert (states.fault and states.fault.kind) == kind
    assert states.last.dt == 0.004  # bounded for the torque rate limit


def test_the_bound_on_a_jump_grows_with_the_time_between_states() -> None:
    step = np.eye(7)[2]
    for size, stamp, jumps in ((0.09, 2, 0), (0.11, 2, 1), (0.19, 4, 0), (0.21, 4, 1)):
        states = checks()
        states.take(stamp * MS, Q + size * step, ZERO, restart=False)
        assert states.counters["jumps"] == jumps
        assert (states.fault and states.fault.kind) == (FaultKind.JUMP if jumps else None)
        assert states.fault is None or states.fault.text.startswith("joint 3 jumped")
        states.refuse()
        assert states.fault is None and states.refused_in_row == 1  # it belongs to one state only


@pytest.mark.parametrize("speed", [0.3, -0.3])
def test_a_missing_velocity_is_estimated_and_comes_to_rest_bit_for_bit(speed: float) -> None:
    states = checks()
    for k in range(1, 101):
        states.take(2 * MS * k, Q + speed * 0.002 * k, None, restart=False)
        expected = speed * (1.0 - math.exp(-180.0 * 0.002 * k))
        np.testing.assert_allclose(states.last.qd, expected, rtol=1e-6)
    end = states.last.q
    states.take(210 * MS, end, None, restart=False)
    np.testing.assert_allclose(states.last.qd, speed, rtol=1e-6)  # kept across a gap
    for k in range(106, 206):
        states.take(2 * MS * k, end, None, restart=False)
    assert np.array_equal(states.last.qd, ZERO)


def test_a_position_is_plausible_up_to_20_radians_and_a_speed_to_500() -> None:
    for bound, largest in ((IMPLAUSIBLE_Q, 20.0), (IMPLAUSIBLE_QD, 500.0)):
        for sign in (1.0, -1.0):
            inside = [sign * math.nextafter(largest, 0.0)] * 7  # together longer than the bound
            assert plausible(inside, bound)
            assert not plausible([*inside[:6], sign * largest], bound)
            assert not plausible([0.0] * 6 + [sign * largest], bound)


@pytest.mark.requirement("S-11")
def test_five_refusals_are_a_fault_when_less_than_fifty_states_lie_between() -> None:
    for last, kind in ((50, FaultKind.STATES_REFUSED), (51, None)):
        for unread in (False, True):
            states = checks()
            for k in range(1, last + 1):
                refused = k in (1, 2, 3, 4, last)
                if refused and unread:
                    states.refuse()  # could not even be read
                else:
                    states.take(k * 2 * MS, None if refused else Q, ZERO, restart=False)
            assert (states.fault and states.fault.kind) == kind
            assert states.counters["rejected"] == 5


@pytest.mark.requirement("S-14")
def test_positions_three_periods_apart_are_differentiated_and_later_ones_are_not() -> None:
    for stamp, moved in ((6 * MS, True), (6 * MS + 1, False)):
        states = checks()
        states.take(stamp, Q + 0.01, None, restart=False)
        assert states.last.qd.any() == moved


def test_time_is_by_the_own_clock_where_there_is_one_and_motion_by_the_longer_of_both() -> None:
    states, found = checks(), []
    for stamp, elapsed in ((2 * MS, None), (4 * MS, 1e-4), (4_200_000, 0.0025), (7 * MS, 5.0)):
        state = states.take(stamp, Q, ZERO, restart=False, elapsed=elapsed)
        found.append((state.dt, state.span))
    assert found == [(0.002, 0.002), (1e-4, 0.002), (0.0025, 0.0025), (0.004, 0.004)]
