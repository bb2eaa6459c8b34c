# SPDX-License-Identifier: Apache-2.0
"""Stopping rule: when the runs of one mean show that it succeeds often enough.

Successes in a row show a rate with a confidence of 95 %: 10 of 10 one of 0.74, 29 of 29 one of 0.9.
Margins show it with fewer. The model: a rollout succeeds if all its margins are positive and
nothing fails that no margin shows. Margins of one mean are independent and normally distributed;
the standard deviation that the task expects counts as `EXPECTED` observations. The share that fails
for another reason is that of all means of the session after a success, with the prior `OTHER`. A
mean is confirmed once the rate is exceeded with the probability `BELIEF`, given all its runs. So
one may look after each.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from scipy.special import betaincinv, gammaincinv, log_ndtr, ndtri

from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.tasks.task import LoggedRollout

CONFIDENCE = 0.95  # of what a number of successes in a row shows
BELIEF = 0.97  # probability of the rate that confirms a mean by its margins
EXPECTED = 4  # observations that the expected standard deviation of a margin counts as
OTHER = (1.0, 45.0)  # rollouts that failed for another reason and that did not, before the first
DRAWS = 2048  # of a posterior distribution


def rate_shown(count: int) -> float:
    """Smallest probability of success that a number of successes in a row shows [1]."""
    return float((1.0 - CONFIDENCE) ** (1.0 / count))


def inside(ratio: np.ndarray, count: int, freedom: int) -> np.ndarray:
    """Logarithms of the probability that all margins of a rollout are positive, (DRAWS,) draws.

    They are drawn from its posterior distribution, equal ones for equal arguments. `ratio` (m,) are
    the mean margins of `count` runs over their standard deviations, which have `freedom` >= 1
    degrees of freedom.
    """
    rates = np.zeros(DRAWS)
    for k, value in enumerate(ratio):
        shift = _draws(ndtri, 2 * k + 1) / math.sqrt(count)
        deviation = np.sqrt(2.0 * _draws(gammaincinv, 2 * k + 2, 0.5 * freedom) / freedom)
        rates += log_ndtr(value * deviation + shift)
    return rates


@cache
def _draws(inverse: Callable[..., np.ndarray], seed: int, *parameters: float) -> np.ndarray:
    """Evenly spread draws of a distribution, by its inverse, in an order of the seed's."""
    order = np.random.Generator(np.random.PCG64(seed)).permutation(DRAWS)
    return inverse(*parameters, (order + 0.5) / DRAWS)


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
            other = not record.success and min(margins, default=0.0) > 0.0
            self._other += (other, record.success)
        self.z, self.count = (np.array(record.z), before + 1) if record.success else (None, 0)
        if record.success:
            return self._judged(len(margins))
        return f"ended after {before} successes in a row" if before else ""

    def _judged(self, size: int) -> str:
        """Confirm the mean, end its row or go on; returns a remark for the log."""
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
        otherwise = np.log1p(-_draws(betaincinv, 0, *self._other))

        def shown_by(more: int) -> bool:
            """Whether the rate is shown after so many more successes with margins like these."""
            rates = inside(ratio, runs + more, freedom + more) + otherwise
            return bool(np.mean(rates >= math.log(rate)) >= BELIEF)

        if shown_by(0):
            shown = f"at least {rate:.0%} will ({BELIEF:.0%} probable)"
            self.complete = (
                f"{self._succeeded} of {runs} succeeded, well inside the limits: {shown}"
            )
            return said
        needed = 1 + bisect_left(range(1, enough - self.count), True, key=shown_by)
        # By its margins it would more likely fail before; what else fails, fails any mean.
        if needed * np.median(inside(ratio, runs, freedom)) < math.log(0.5):
            self.z, self.count = None, 0
            return f"{said}, but with too small margins: learning goes on"
        return said
