# SPDX-License-Identifier: Apache-2.0
"""The watchdogs detect missing states, false stamps and missed periods, on a simulated clock."""

import pytest

from wam_power_ros.control.watchdog import StampClock, Watchdog, overload
from wam_power_ros.faults import FaultKind

MS = 1_000_000


def watched(until_ms: int, watchdog: Watchdog, since_ms: int = 0) -> list[tuple[int, object]]:
    """Check once a millisecond and answer every timeout; returns times [ms] and timeouts."""
    found = []
    for ms in range(since_ms, until_ms):
        silence = watchdog.check(ms * MS)
        if silence is not None:
            found.append((ms, silence))
            watchdog.sent_ns = ms * MS
    return found


def fresh() -> Watchdog:
    """A watchdog of 5 ms that has just registered a state and a torque."""
    watchdog = Watchdog(0.005, 0.002)
    watchdog.check(-MS)
    watchdog.arrived(0)
    watchdog.sent_ns = 0
    watchdog._grace_ns = 0  # the very first check begins a grace time
    return watchdog


def test_a_long_loss_of_states_is_a_fault_and_a_longer_one_asks_to_idle_once() -> None:
    watchdog = fresh()
    found = watched(300, watchdog)
    faults = [ms for ms, silence in found if silence.fault is not None]
    assert 20 < faults[0] <= 22 and faults[-1] >= 298
    assert found[-1][1].fault.kind is FaultKind.STATES_LOST
    idle = [ms for ms, silence in found if silence.idle]
    assert len(idle) == 1 and 100 < idle[0] <= 102
    watchdog.arrived(300 * MS)
    assert watched(305, watchdog, 300) == []
    again = watched(500, watchdog, 305)
    assert sum(silence.idle for _, silence in again) == 1  # once per loss of states


def test_a_repeated_last_state_counts_as_silence_after_the_timeout() -> None:
    watchdog = fresh()
    assert not watchdog.silent(5 * MS) and watchdog.silent(6 * MS)
    watchdog.arrived(6 * MS)
    assert not watchdog.silent(7 * MS)
    assert not Watchdog(0.0, 0.002).silent(10**12)  # in lockstep


def test_a_process_that_was_stopped_reads_the_queued_states_first() -> None:
    watchdog = fresh()
    watched(5, watchdog)
    found = watched(560, watchdog, 505)  # stopped for half a second
    assert found[0][0] == 525
    for pause_ns, excused in ((20 * MS, False), (20 * MS + 1, True)):
        watchdog = fresh()
        watchdog.check(10 * MS)
        assert (watchdog.check(10 * MS + pause_ns) is None) == excused
    watchdog = fresh()
    watched(5, watchdog)
    watchdog.check(505 * MS)
    watchdog.arrived(506 * MS)
    watchdog.sent_ns = 506 * MS
    assert watched(511, watchdog, 507) == []


def test_the_time_to_the_next_check_ends_when_a_torque_is_due() -> None:
    watchdog = fresh()
    assert watchdog.time_to_check(2 * MS) == pytest.approx(0.003)
    watchdog.sent_ns = 4 * MS
    assert watchdog.time_to_check(5 * MS) == pytest.approx(0.001)
    assert watchdog.time_to_check(9 * MS) == 0.0
    watchdog.arrived(1000 * MS)
    assert watchdog.time_to_check(10 * MS) == 0.01  # the longest time between two checks


@pytest.mark.parametrize(
    ("share", "in_row", "warned", "fault"),
    [
        (0.01, 2, False, False),
        (0.011, 1, True, False),
        (0.05, 3, True, False),
        (0.051, 1, True, True),
    ],
)
def test_missed_periods_are_a_warning_and_too_many_a_fault(
    share: float, in_row: int, warned: bool, fault: bool
) -> None:
    text, found = overload(share, in_row)
    assert bool(text) == warned and (found is not None) == fault
    if found is not None:
        assert (found.kind, found.text) == (FaultKind.OVERLOAD, text)


def test_without_any_state_the_driver_is_asked_to_idle_once_after_each_activation() -> None:
    watchdog = Watchdog(0.005, 0.002)
    for start_ms in (10_000, 10_200):
        found = watched(start_ms + 200, watchdog, start_ms)
        assert [silence.idle for _, silence in found] == [True] + [False] * (len(found) - 1)
        assert all(silence.fault.kind is FaultKind.STATES_LOST for _, silence in found)
        watchdog.activated()


def test_a_fault_needs_more_than_20_ms_and_idling_more_than_100() -> None:
    for age_ns, fault, idle in (
        (20 * MS, False, False),
        (20 * MS + 1, True, False),
        (100 * MS, True, False),
        (100 * MS + 1, True, True),
    ):
        watchdog = fresh()
        for ms in range(age_ns // MS - 1):
            watchdog.check(ms * MS)
        silence = watchdog.check(age_ns)
        assert ((silence.fault is not None), silence.idle) == (fault, idle)


@pytest.mark.requirement("S-51")
@pytest.mark.parametrize(("rate", "fault"), [(0.1, True), (1.2, False), (3.0, True)])
def test_stamps_at_another_speed_than_real_time_are_a_fault(rate: float, fault: bool) -> None:
    clock = StampClock()
    found = [clock.check(round(rate * ms * MS), ms * MS) for ms in range(0, 1000, 2)]
    kinds = {each.kind for each in found if each is not None}
    assert kinds == ({FaultKind.STAMPS} if fault else set())
    assert found[:100] == [None] * 100  # what is shorter may be a late message
