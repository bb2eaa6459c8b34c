# SPDX-License-Identifier: Apache-2.0
"""Gaps in the stamps of a topic."""

from collections.abc import Iterable

import numpy as np
import pytest
from bag_samples import START

from wam_power_ros.bags.gaps import GapCounter, Gaps


def find_gaps(stamps_ns: Iterable[int]) -> Gaps:
    counter = GapCounter()
    for stamp_ns in stamps_ns:
        counter.add(int(stamp_ns))
    return counter.gaps()


def test_gaps_are_counted_in_periods() -> None:
    stamps = START + 2_000_000 * np.array([0, 1, 2, 2, 3, 6, 7, 8, 20])
    found = find_gaps(stamps)
    assert found.period == pytest.approx(0.002)
    assert found.missing == 2 + 11
    assert found.longest == pytest.approx(0.024)
    assert find_gaps([START]).missing == 0


def test_a_gap_after_the_period_is_known_counts_as_one_before(seed: int = 3) -> None:
    rng = np.random.default_rng(seed)
    steps = np.full(3 * GapCounter.PERIOD_INTERVALS, 2_000_000)
    places = rng.choice(len(steps), 20, replace=False)
    steps[places] *= 4  # three are missing at each
    found = find_gaps(1_000_000_000 + np.cumsum(steps))
    assert found.missing == 3 * np.count_nonzero(places > 0)  # the first step is no interval
    assert (found.period, found.longest) == pytest.approx((0.002, 0.008))


def test_stamps_that_repeat_or_go_back_make_no_gap() -> None:
    stamps = 1_000_000 * np.array([10, 20, 20, 30, 15, 25, 35])
    assert find_gaps(stamps).missing == 0


@pytest.mark.parametrize("stamps_ns", [[], [5]])
def test_without_an_interval_there_is_nothing_to_find(stamps_ns: list[int]) -> None:
    assert find_gaps(stamps_ns) == Gaps(0.0, 0, 0.0)
