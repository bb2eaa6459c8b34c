# SPDX-License-Identifier: Apache-2.0
"""Stopping rule: when the runs of one mean show that it succeeds often enough.

Successes in a row show a rate with a confidence of 95 %: 10 of 10 one of 0.74, 29 of 29 one of 0.9.
Margins show it with fewer. The model: a rollout succeeds if all its margins are positive and
nothing fails that no margin shows. Margins of one mean are independent and normally distributed;
the standard deviation that the task expects counts as `EXPECTED` observations. The share that fails
for another reason is that of all means of the session after a success, with the prior `OTHER`. A
run outside its limits may be of either kind: Bayes' rule tells how likely. A mean is confirmed once
the rate is exceeded with the probability `BELIEF`, given all its runs. So one may look after each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import log_ndtr

from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.tasks.task import LoggedRollout

CONFIDENCE = 0.95  # of what a number of successes in a row shows
BELIEF = 0.97  # probability of the rate that confirms a mean by its margins
EXPECTED = 4  # observations that the expected standard deviation of a margin counts as
OTHER = (1.0, 45.0)  # rollouts that failed for another reason and that did not, before the first
DRAWS = 8192  # of a posterior distribution


def rate_shown(count: int) -> float:
    """Smallest probability of success that a number of successes in a row shows [1]."""
    return float((1.0 - CONFIDENCE) ** (1.0 / count))


def inside(ratio: np.ndarray, count: int, freedom: int) -> np.ndarray:
    """Logarithms of the probability that all margins of a rollout are positive, (DRAWS,) draws.

    They are drawn from its posterior distribution, equal ones for equal arguments. `ratio` (m,) are
    the mean margins of `count` runs over their standard deviations, which have `freedom` >= 1
    degrees of freedom.
    """
    rng = np.random.Generator(np.random.PCG64(0))
    deviation = np.sqrt(rng.chisquare(freedom, (DRAWS, len(ratio))) / freedom)
    shift = rng.standard_normal(deviation.shape) / math.sqrt(count)
    log_rates: np.ndarray = log_ndtr(ratio * deviation + shift).sum(axis=1)
    return log_rates


class StoppingRule:
    """Judges the successes in a row of one mean.

    `settings.confirm` successes are enough whatever their margins; 0 disables the rule. For
    `margins` and their `scatter` see `Task.success_margins` and `Task.scatter`.

    Attributes:
        z: Coordinates of the mean being confirmed, None when there is none. Shape (size,).
        count: Number of successes in a row of that mean.
        complete: Why it is confirmed, empty while it is not.
        mean_is_due: Whether the mean is run next because another rollout succeeded.
    """

    def __init__(
        self,
        settings: PracticeSettings,
        margins: Callable[[LoggedRollout], Sequence[float]],
        scatter: Sequence[float] = (),
    ) -> None:
        self._settings, self._margins, self._scatter = settings, margins, scatter
        self._other = np.array(OTHER)
        self.complete, self.mean_is_due = "", False
        self._begin([])

    def _begin(self, mean: list[float]) -> None:
        self._mean, self._runs = mean, list[Sequence[float]]()  # its margins
        self._succeeded = self.count = 0
        self._inside = -math.inf  # log-probability that the margins of its next run are positive
        self.z: np.ndarray | None = None

    def forget(self, record: Record) -> None:
        """End the row if a rollout that is no success any more was part of it."""
        if record.kind == "mean" and record.z == self._mean:
            self._begin([])

    def add(self, record: Record) -> str:
        """Judge a rollout of the practice; returns a remark for the log, may be empty."""
        if self._settings.confirm == 0:
            return ""
        if record.kind != "mean":
            due = record.kind == "reproduction" or self._settings.mean_every == 0
            due = due and record.success
            self.mean_is_due |= due
            return "a success: the mean policy is run to confirm it" if due else ""
        if record.z != self._mean:
            self._begin(record.z)
        margins, self.mean_is_due, before = tuple(self._margins(record)), False, self.count
        self._runs.append(margins)
        self._succeeded += record.success
        if before:  # a mean that has not succeeded may fail in ways that a good one does not
            self._other += (self._otherwise(record.success, margins), record.success)
        self.z, self.count = (np.array(record.z), before + 1) if record.success else (None, 0)
        if record.success:
            return self._judged(len(margins))
        return f"ended after {before} successes in a row" if before else ""

    def _otherwise(self, success: bool, margins: Sequence[float]) -> float:
        """Probability that a run failed for another reason than the scatter of its margins."""
        if min(margins, default=0.0) > 0.0:
            return float(not success)
        share = self._other[0] / self._other.sum()
        return float(share / (share - math.expm1(self._inside))) if margins else 0.0

    def _judged(self, size: int) -> str:
        """Confirm the mean, seek a better one or go on; returns a remark for the log."""
        enough, runs = self._settings.confirm, len(self._runs)
        rate = rate_shown(enough)
        said = f"{self.count} {'success' if self.count == 1 else 'successes'} in a row"
        if self.count >= enough:
            shown = f"at least {rate:.0%} will ({CONFIDENCE:.0%} confidence)"
            self.complete = f"{self.count} of {self.count} succeeded: {shown}"
            return said
        expected = len(self._scatter) == size
        freedom = runs - 1 + EXPECTED * expected
        if not size or freedom < 1 or any(len(each) != size for each in self._runs):
            return said
        prior = np.square(self._scatter) if expected else 0.0
        squares = runs * np.var(self._runs, axis=0) + EXPECTED * prior
        if not squares.all():  # equal margins, as of a reading in coarse steps, show no scatter
            return said
        ratio = np.mean(self._runs, axis=0) / np.sqrt(squares / freedom)
        rates = inside(ratio, runs, freedom)
        self._inside = float(np.median(rates))
        rng = np.random.Generator(np.random.PCG64(1))
        rates += np.log1p(-rng.beta(self._other[0], self._other[1], DRAWS))
        if np.mean(rates >= math.log(rate)) >= BELIEF:
            shown = f"at least {rate:.0%} will ({BELIEF:.0%} probable)"
            self.complete = (
                f"{self._succeeded} of {runs} succeeded, well inside the limits: {shown}"
            )
        elif (enough - self.count) * self._inside < math.log(0.5):
            # It would more likely fail before. What else fails, fails any mean.
            self.z = None
            return f"{said}, but with too small margins: a better one is sought"
        return said
