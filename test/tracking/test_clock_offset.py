# SPDX-License-Identifier: Apache-2.0
"""The offset between two clocks is distinguished from late frames."""

import pytest

from wam_power_ros.tracking.tracker import ClockOffset, late_stamps

START = 1_700_000_000_000_000_000


def test_the_offset_of_two_clocks_is_the_age_that_jitter_cannot_lower() -> None:
    offset = ClockOffset()
    assert offset.seconds == 0.0
    for jitter in (7_000_000, 0, 3_000_000):
        offset.add(START, START + 250_000_000 + jitter)
    assert offset.seconds == pytest.approx(0.25)
    for index in range(240):  # two seconds of frames at once: the tracker was not scheduled
        offset.add(START + index * 8_333_333, START + 2_500_000_000 + index * 100_000)
    assert offset.seconds == pytest.approx(0.25)
    for index in range(20):  # if all frames are late for long, the clocks differ
        now_ns = START + (5 + index) * 1_000_000_000
        offset.add(now_ns - 600_000_000, now_ns)
    assert offset.seconds == pytest.approx(0.6)
    recent = ClockOffset()
    for second, age in ((0.0, 0.1), (5.0, 0.3), (5.1, 0.3)):
        recent.add(START + round((second - age) * 1e9), START + round(second * 1e9))
        assert recent.seconds == pytest.approx(0.1 if second <= 5.0 else 0.3)
    behind = ClockOffset()
    behind.add(START, START - 40_000_000)
    assert behind.seconds == pytest.approx(-0.04)


def test_late_stamps_have_the_cause_that_can_be_seen() -> None:
    assert "0.600 s off: synchronise the clocks" in late_stamps(0.6)
    assert "use_sim_time" in late_stamps(1.7e9) and "use_sim_time" in late_stamps(-1.7e9)
