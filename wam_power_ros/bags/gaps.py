# SPDX-License-Identifier: Apache-2.0
"""Gaps in the stamps of a topic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Gaps(NamedTuple):
    """Gaps between the stamps of a topic.

    Attributes:
        period: Median interval between messages [s]; 0 without an interval.
        missing: Number of messages that would fill the intervals longer than 1.5 periods.
        longest: Longest interval [s].
    """

    period: float
    missing: int
    longest: float


def gaps(stamps_ns: Sequence[int] | np.ndarray) -> Gaps:
    """Gaps between stamps [ns], in the order of reception; stamps that repeat or go back make none.

    Args:
        stamps_ns: Stamps. Shape (M,).
    """
    steps = np.diff(np.asarray(stamps_ns, dtype=np.int64))
    steps = steps[steps > 0]
    if not len(steps):
        return Gaps(0.0, 0, 0.0)
    period = float(np.median(steps))
    missing = np.rint(steps[steps > 1.5 * period] / period) - 1.0
    return Gaps(period * 1e-9, int(missing.sum()), float(steps.max()) * 1e-9)
