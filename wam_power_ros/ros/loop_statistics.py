# SPDX-License-Identifier: Apache-2.0
"""Timing statistics of a periodic loop; reads no clock."""

from __future__ import annotations

from array import array

import numpy as np

CAPACITY = 4096  # cycles between two reports; further ones are not counted


class LoopStatistics:
    """Arrivals and departures of the cycles since the last report."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._arrived = array("q", bytes(8 * CAPACITY))
        self._left = array("q", bytes(8 * CAPACITY))
        self._count = 0
        self._last_arrival: int | None = None  # in the previous report [ns]
        self.missed = 0  # periods missed since the start
        self.share_missed = 0.0  # of the periods in the last report
        self.missed_in_row = 0  # longest run in the last report

    def add(self, arrived_ns: int, left_ns: int) -> None:
        """Add a cycle: arrival of its input and departure of its output [ns, steady clock]."""
        i = self._count
        if i < CAPACITY:
            self._arrived[i], self._left[i] = arrived_ns, left_ns
            self._count = i + 1

    def report(self) -> dict[str, str]:
        """Return figures of the cycles since the last report, with units, and reset them."""
        count, before = self._count, self._last_arrival
        self._count, self._last_arrival = 0, None
        self.share_missed, self.missed_in_row = 0.0, 0
        if count == 0:
            return {"cycles": "0"}
        arrived, left = (np.frombuffer(x, np.int64)[:count] for x in (self._arrived, self._left))
        self._last_arrival = int(arrived[-1])
        periods = np.diff(arrived) if before is None else np.diff(arrived, prepend=before)
        lost = np.maximum(np.rint(periods / self._period_ns) - 1, 0).astype(int)
        self.missed += int(lost.sum())
        self.share_missed = float(lost.sum() / (lost.sum() + count))
        self.missed_in_row = int(lost.max(initial=0))
        step = (left - arrived) * 1e-3
        figures = {"cycles": str(count), "periods missed": str(self.missed)}
        for name, value in (("median", 50.0), ("p99", 99.0), ("max", 100.0)):
            if len(periods):
                figures[f"period {name} [ms]"] = f"{np.percentile(periods, value) * 1e-6:.3f}"
            figures[f"step {name} [us]"] = f"{np.percentile(step, value):.0f}"
        return figures
