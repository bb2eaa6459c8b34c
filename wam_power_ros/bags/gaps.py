# SPDX-License-Identifier: Apache-2.0
"""Gaps in the stamps of a topic, counted online."""

from __future__ import annotations

from array import array
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Gaps:
    """Gaps between the stamps of a topic.

    Attributes:
        period: Median interval between messages [s].
        missing: Number of messages that would fill the intervals longer than 1.5 periods.
        longest: Longest interval [s].
    """

    period: float
    missing: int
    longest: float


class GapCounter:
    """Counts gaps in the stamps of one topic online, in constant memory.

    The period is the median of the first `PERIOD_INTERVALS` intervals; repeated stamps count once.
    """

    PERIOD_INTERVALS = 1000

    def __init__(self) -> None:
        self._last: int | None = None
        self._first_steps = array("q")  # [ns]
        self._period = 0.0  # [ns], 0 until it is known
        self._missing = 0
        self._longest = 0  # [ns]

    def add(self, stamp_ns: int) -> None:
        """Add the next stamp [ns]."""
        step = 0 if self._last is None else stamp_ns - self._last
        self._last = stamp_ns
        if step <= 0:
            return
        self._longest = max(self._longest, step)
        if self._period:
            self._missing += _missing(step, self._period)
            return
        self._first_steps.append(step)
        if len(self._first_steps) == self.PERIOD_INTERVALS:
            found = self.gaps()
            self._period, self._missing = found.period * 1e9, found.missing
            self._first_steps = array("q")

    def gaps(self) -> Gaps:
        """Return the gaps so far."""
        period, missing = self._period, self._missing
        if self._first_steps:
            period = float(np.median(self._first_steps))
            missing = sum(_missing(step, period) for step in self._first_steps)
        return Gaps(period * 1e-9, missing, self._longest * 1e-9)


def _missing(step: int, period: float) -> int:
    return round(step / period) - 1 if step > 1.5 * period else 0
