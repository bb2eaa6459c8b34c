# SPDX-License-Identifier: Apache-2.0
"""Stopping rule: how many successes of one mean, and how clear ones, end a session.

A number of successes in a row shows, with a confidence of 95 %, that a further rollout succeeds
with at least some probability: 10 of 10 one of 0.74, 29 of 29 one of 0.9. A row is run once for a
mean and ends with its first failure, so the number is exact however often one looks. Margins show
the same with fewer rollouts: if they are normally distributed, a one-sided tolerance interval
bounds the share of rollouts that are inside a limit. Their standard deviation is that of the row,
weighed against the one which the task expects, if it does. The interval is looked at after every
success, and only while there is no failure, which selects rows that look better than they are.
Hence a single look must show more (`LOOK_CONFIDENCE`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from scipy.special import nctdtrit, ndtri

from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.tasks.task import LoggedRollout

CONFIDENCE = 0.95
LOOK_CONFIDENCE = 0.995  # of a single look at one margin
# Successes before margins count. They do not show what fails now and then for another reason, like
# a body that lay elsewhere. Hence one more for each row that a failure has ended, and two for each
# of the latest runs of a mean that failed although all its margins were positive.
ROW_MIN = 5
UNEXPLAINED = 2
RECENT = 12  # runs of a mean
EXPECTED = 4  # observations that the expected standard deviation of a margin counts as
# A row ends when its margins would need more further successes than clear ones of another mean, and
# this many rollouts to find it; this many more for each row that has ended so, because the arm may
# not be able to do better.
SEARCH = 3


def rate_shown(count: int) -> float:
    """Smallest probability of success that a number of successes in a row shows [1]."""
    return float((1.0 - CONFIDENCE) ** (1.0 / count))


@cache
def tolerance_factor(count: int, freedom: int, rate: float) -> float:
    """Mean margin, in standard deviations, that shows a share of positive margins.

    They are `count` independent, normally distributed margins, whose standard deviation has
    `freedom` >= 1 degrees of freedom; `rate` is to be shown with `LOOK_CONFIDENCE`.
    """
    root = math.sqrt(count)
    return float(nctdtrit(freedom, root * ndtri(rate), LOOK_CONFIDENCE)) / root


class StoppingRule:
    """Judges the successes in a row of one mean.

    `settings.confirm` successes are enough whatever their margins; 0 disables the rule. For
    `margins` and their `scatter` see `Task.margins` and `Task.margin_scatter`.

    Attributes:
        z: Coordinates of the mean being confirmed, None when there is none. Shape (size,).
        complete: Why it is confirmed, empty while it is not.
        mean_is_due: Whether the mean is run next because another rollout succeeded.
    """

    def __init__(
        self,
        settings: PracticeSettings,
        margins: Callable[[LoggedRollout], Sequence[float]],
        scatter: Sequence[float] = (),
    ) -> None:
        self._settings = settings
        self._scatter = scatter
        self._margins_of = margins
        self._margins: list[Sequence[float]] = []  # one row for each success
        self._failed = 0  # rows that a failure has ended
        self._long = 0  # rows that have ended because they would have been long
        self._unexplained: deque[bool] = deque(maxlen=RECENT)  # failures that no margin explains
        self.z: np.ndarray | None = None
        self.complete = ""
        self.mean_is_due = False

    @property
    def count(self) -> int:
        """Number of successes in a row of the mean being confirmed."""
        return len(self._margins)

    def add(self, record: Record) -> str:
        """Judge a rollout of the practice; returns a remark for the log, may be empty."""
        if self._settings.confirm == 0:
            return ""
        if record.kind == "mean":
            return self._add_mean(record)
        if record.success and (record.kind == "reproduction" or self._settings.mean_every == 0):
            self.mean_is_due = True
            return "a success: the mean policy is run to confirm it"
        return ""

    def forget(self, record: Record) -> None:
        """End the row if a rollout that is no success any more was part of it."""
        if self.z is not None and record.kind == "mean" and record.z == self.z.tolist():
            self._end()

    def _add_mean(self, record: Record) -> str:
        self.mean_is_due, before = False, self.count
        if not record.success:
            self._end()
            self._failed += before > 0
            self._unexplained.append(min(self._margins_of(record), default=0.0) > 0.0)
            return f"ended after {before} successes in a row" if before else ""
        if self.z is None or record.z != self.z.tolist():
            self._end()
        self._unexplained.append(False)
        self.z = np.array(record.z)
        self._margins.append(tuple(self._margins_of(record)))
        return self._judge()

    def _end(self) -> None:
        self.z, self._margins = None, []

    def _judge(self) -> str:
        """Confirm the mean, end its row or go on; returns a remark for the log."""
        count, enough = self.count, self._settings.confirm
        said = f"{count} {'success' if count == 1 else 'successes'} in a row"
        if count >= enough:
            self.complete = f"{count} of {count} succeeded: {_shown(count)}"
            return said
        size = len(self._margins[0])
        expected = len(self._scatter) == size
        if not size or any(len(each) != size for each in self._margins):
            return said
        if count < ROW_MIN and not expected:
            return said
        rows = np.array(self._margins)
        freedom, squares = count - 1, count * rows.var(axis=0)
        if expected:
            freedom, squares = freedom + EXPECTED, squares + EXPECTED * np.square(self._scatter)
        mean, sd, rate = rows.mean(axis=0), np.sqrt(squares / freedom), rate_shown(enough)
        needed = ROW_MIN + self._failed + UNEXPLAINED * sum(self._unexplained)
        few = max(needed - count, 0)
        if not few and (mean > tolerance_factor(count, freedom, rate) * sd).all():
            inside = "all well inside the limits"
            self.complete = f"{count} of {count} succeeded, {inside}: {_shown(enough)}"
            return said
        # It would more likely fail than not before it shows something.
        if (mean < float(ndtri(0.5 ** (1.0 / (few or enough - count)))) * sd).any():
            self._end()
            return f"{said}, but with too small margins: learning goes on"
        free = freedom - count
        ends = (
            n
            for n in range(count + 1, enough)
            if (mean > tolerance_factor(n, n + free, rate) * sd).all()
        )
        if next(ends, enough) - count > needed + SEARCH * (1 + self._long):
            self._long += 1
            self._end()
            return f"{said}, but margins that need many more: learning goes on"
        return said


def _shown(count: int) -> str:
    """What a number of successes in a row shows, in words."""
    return f"at least {rate_shown(count):.0%} will ({CONFIDENCE:.0%} confidence)"
