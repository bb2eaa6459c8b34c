# SPDX-License-Identifier: Apache-2.0
"""Gaps in the stamps of a topic."""

import numpy as np
import pytest
from bag_samples import START

from wam_power_ros.bags.quality import Gaps, gaps


def test_gaps_are_counted_in_periods() -> None:
    stamps = START + 2_000_000 * np.array([0, 1, 2, 2, 3, 6, 7, 8, 20])
    found = gaps(stamps)
    assert found.period == pytest.approx(0.002)
    assert found.missing == 2 + 11
    assert found.longest == pytest.approx(0.024)
    assert gaps([]) == gaps([START]) == Gaps(0.0, 0, 0.0)


def test_stamps_that_repeat_or_go_back_make_no_gap() -> None:
    stamps = 1_000_000 * np.array([10, 20, 20, 30, 15, 25, 35])
    assert gaps(stamps).missing == 0
