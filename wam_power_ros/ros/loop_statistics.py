# SPDX-License-Identifier: Apache-2.0
"""How well a periodic loop keeps its time; the times are handed in."""

from __future__ import annotations

from array import array

import numpy as np

CAPACITY = 4096  # cycles between two reports


class LoopStatistics:
    """Arrivals and departures of the cycles since the last report.

    Args:
        period_ns: Of the loop [ns].
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._arrived = array("q", bytes(8 * CAPACITY))
        self._left = array("q", bytes(8 * CAPACITY))
        self._count = 0
        self._before: int | None = None  # the last arrival of the report before
        self.missed = 0  # periods, since the start
        self.share_missed = 0.0  # of the periods of the last report
        self.missed_in_row = 0  # at worst, in the last report

    def add(self, arrived_ns: int, left_ns: int) -> None:
        """One cycle, from its input's arrival to its output's departure [ns, steady clock]."""
        i = self._count
        if i < CAPACITY:
            self._arrived[i], self._left[i] = arrived_ns, left_ns
            self._count = i + 1

    def report(self) -> dict[str, str]:
        """Figures of the cycles since the last report, with their units, and begin anew."""
        count, before = self._count, self._before
        self._count, self._before = 0, None
        self.share_missed, self.missed_in_row = 0.0, 0
        if count == 0:
            return {"cycles": "0"}
        arrived, left = (np.frombuffer(x, np.int64)[:count] for x in (self._arrived, self._left))
        self._before = int(arrived[-1])
        first = arrived[0] if before is None else before
        periods = np.diff(arrived, prepend=first)[1 if before is None else 0 :]
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
