# SPDX-License-Identifier: Apache-2.0
"""Timing statistics of a loop, from given arrivals."""

import pytest

from wam_power_ros.ros.loop_statistics import LoopStatistics

PERIOD = 2_000_000  # [ns]


@pytest.mark.requirement("S-50")
def test_missed_periods_are_counted_as_share_and_in_a_row() -> None:
    statistics, now = LoopStatistics(PERIOD), 10**9
    for cycle in range(200):
        now += PERIOD * {50: 2, 100: 4}.get(cycle, 1) + (cycle % 3) * 100_000 - 100_000
        statistics.add(now, now + 300_000)
    report = statistics.report()
    assert report["periods missed"] == "4"
    assert report["step median [us]"] == "300"
    assert statistics.share_missed == 4 / 204
    assert statistics.missed_in_row == 3
    statistics.add(now + PERIOD, now + PERIOD)
    statistics.report()
    assert (statistics.share_missed, statistics.missed_in_row) == (0.0, 0)


@pytest.mark.requirement("S-50")
def test_a_gap_between_two_reports_counts_and_silence_does_not() -> None:
    statistics = LoopStatistics(PERIOD)
    statistics.add(0, 1)
    statistics.report()
    statistics.add(11 * PERIOD, 11 * PERIOD)
    assert statistics.report()["periods missed"] == "10"
    assert statistics.report() == {"cycles": "0"}
    assert statistics.missed_in_row == 0
