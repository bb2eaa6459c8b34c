# SPDX-License-Identifier: Apache-2.0
"""Stopping rule: how many successes of one mean, and how clear ones, end a session.

A number of successes in a row shows, with a confidence of 95 %, that a further rollout succeeds
with at least some probability: 10 of 10 one of 0.74, 29 of 29 one of 0.9. Margins show the same
with fewer. The model: the margins of one mean are normally distributed, and a rollout may also fail
for a reason that no margin has. A one-sided tolerance interval [Odeh1980] bounds the share of the
rollouts that are inside a limit.

What is known before a row counts as `BEFORE` observations: the scatter that the task states, and
how often runs of earlier means failed without such a reason.

The interval is looked at after each success. Look l of a session may be wrong with a probability
of 5 % / l (l + 1); together these are 5 %, however often and at however many means one looks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from scipy.special import nctdtrit, ndtr, ndtri

from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.tasks.task import LoggedRollout

CONFIDENCE = 0.95
BEFORE = 4  # observations that count as known before a row: few, as the scatter of worlds differs
ROW_MIN = 3  # successes in a row: fewer convince nobody


def rate_shown(count: int) -> float:
    """Smallest probability of success that a number of successes in a row shows [1]."""
    return float((1.0 - CONFIDENCE) ** (1.0 / count))


@cache
def tolerance_factor(count: int, freedom: int, rate: float, look: int) -> float:
    """Mean margin, in standard deviations, that shows a share of positive margins.

    They are `count` independent, normally distributed margins, whose standard deviation has
    `freedom` >= 1 degrees of freedom; `rate` < 1 is to be shown at a look, counted from 1.
    """
    root, confidence = math.sqrt(count), 1.0 - (1.0 - CONFIDENCE) / (look * (look + 1))
    return float(nctdtrit(freedom, root * ndtri(rate), confidence)) / root


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
        self._margins_of = margins
        self._margins: list[Sequence[float]] = []  # one row for each success
        self._scatter = scatter
        self._runs = self._looks = self._unexplained = self._long = 0  # in the session
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
        self.mean_is_due, before, self._runs = False, self.count, self._runs + 1
        margins = tuple(self._margins_of(record))
        if not record.success:
            self._end()
            self._unexplained += min(margins, default=0.0) > 0.0
            return f"ended after {before} successes in a row" if before else ""
        if self.z is None or record.z != self.z.tolist():
            self._end()
        self.z = np.array(record.z)
        self._margins.append(margins)
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
        sizes = {len(each) for each in self._margins}
        if count < ROW_MIN or len(sizes) > 1 or 0 in sizes:
            return said
        self._looks += 1
        freedom, squares = count - 1, count * np.var(self._margins, axis=0)
        if {len(self._scatter)} == sizes:
            freedom, squares = freedom + BEFORE, squares + BEFORE * np.square(self._scatter)
        sd = np.sqrt(np.maximum(squares / freedom, 1e-24))
        clear = np.mean(self._margins, axis=0) / sd  # [standard deviations]
        unexplained = self._unexplained / (BEFORE + self._runs - count)  # share before the row
        least, share = float(clear.min()), float(np.prod(ndtr(clear)))  # of successes

        def shows(further: int) -> bool:
            """Whether so many further successes with these margins show the rate."""
            n, look = count + further, self._looks + further
            rate = rate_shown(enough) / (1.0 - BEFORE * unexplained / (BEFORE + n))
            return rate < 1.0 and least > tolerance_factor(n, freedom + further, rate, look)

        if shows(0):
            inside = f"all well inside the limits ({least:.2g} standard deviations or more)"
            self.complete = f"{count} of {count} succeeded, {inside}: {_shown(enough)}"
            return said
        further = next(filter(shows, range(1, enough - count)), enough - count)
        if share**further < 0.5:
            self._end()
            return f"{said}, but with margins too small to confirm them: learning goes on"
        if further > ROW_MIN * 2 ** (1 + self._long):
            self._long += 1
            self._end()
            return f"{said}, but margins that need many more: learning goes on"
        return said


def _shown(count: int) -> str:
    """What a number of successes in a row shows, in words."""
    return f"at least {rate_shown(count):.0%} will ({CONFIDENCE:.0%} confidence)"
