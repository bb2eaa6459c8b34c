# SPDX-License-Identifier: Apache-2.0
"""Stopping rule: when the runs of one mean show that it succeeds often enough.

Successes show a rate by the binomial distribution: 10 of 10 one of 0.74, 29 of 29 one of 0.9, and
so do 46 of 47. Margins show it with fewer. The model: a rollout succeeds if all its margins are
positive and nothing fails that no margin shows. Margins of one mean are independent and normally
distributed; the standard deviation that the task expects counts as `EXPECTED` observations. The
share that fails for another reason is that of all means of the session after a success, with the
prior `OTHER`. A run outside its limits may be of either kind: Bayes' rule tells how likely. A mean
is confirmed once the rate is exceeded with the probability `BELIEF`, given all its runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import betaincinv, log_ndtr

from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.tasks.task import LoggedRollout

CONFIDENCE = 0.95  # of what a number of successes shows
BELIEF = 0.97  # probability of the rate that confirms a mean by its margins
EXPECTED = 4  # observations that the expected standard deviation of a margin counts as
OTHER = (1.0, 45.0)  # rollouts that failed for another reason and that did not, before the first
DRAWS = 8192  # of a posterior distribution


def rate_shown(successes: int, runs: int) -> float:
    """Lower confidence bound of the success rate of a mean, by Clopper and Pearson [1]."""
    return float(betaincinv(successes, runs - successes + 1, 1.0 - CONFIDENCE))


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
    """Judges the runs of one mean.

    As many successes as `settings.confirm`, without a failure, are enough whatever their margins; 0
    disables the rule.
    For `margins` and their `scatter` see `Task.success_margins` and `Task.scatter`.

    Attributes:
        z: Coordinates of the mean being confirmed, None when there is none. Shape (size,).
        successes, runs: How many the latest mean has had.
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
        self._inside = self._reached = -math.inf
        self._begin([])

    def _begin(self, mean: list[float]) -> None:
        self._mean, self._known = mean, list[Sequence[float]]()  # margins of its runs
        self.successes = self.runs = 0
        # Log-probabilities that the margins of its next run are positive; most of those before it
        self._reached, self._inside = max(self._reached, self._inside), -math.inf
        self.z: np.ndarray | None = None

    def forget(self, record: Record) -> None:
        """Begin anew if a rollout that is no success any more was a run of the mean."""
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
        margins, self.mean_is_due = tuple(self._margins(record)), False
        if self.successes:  # a mean that has not succeeded may fail in ways a good one does not
            self._other += (self._otherwise(record.success, margins), record.success)
        self._known.append(margins)
        self.runs, self.successes = self.runs + 1, self.successes + record.success
        self.z = np.array(record.z) if record.success else None
        said = f"{self.successes} of {self.runs} succeeded" if self.successes else ""
        return self._judged(said, len(margins)) if record.success else said

    def _otherwise(self, success: bool, margins: Sequence[float]) -> float:
        """Probability that a run failed for another reason than the scatter of its margins."""
        if success or min(margins, default=0.0) > 0.0:
            return float(not success)
        share = self._other[0] / self._other.sum()
        return float(share / (share - math.expm1(self._inside))) if margins else 0.0

    def _judged(self, said: str, size: int) -> str:
        """Confirm the mean, seek a better one or go on; returns a remark for the log."""
        enough, runs = self._settings.confirm, self.runs
        rate = rate_shown(enough, enough)
        if rate_shown(self.successes, runs) >= rate:
            self.complete = f"{said}: at least {rate:.0%} will ({CONFIDENCE:.0%} confidence)"
            return said
        expected = len(self._scatter) == size
        freedom = runs - 1 + EXPECTED * expected
        if not size or freedom < 1 or any(len(each) != size for each in self._known):
            return said
        prior = np.square(self._scatter) if expected else 0.0
        squares = runs * np.var(self._known, axis=0) + EXPECTED * prior
        if not squares.all():  # equal margins, as of a reading in coarse steps, show no scatter
            return said
        ratio = np.mean(self._known, axis=0) / np.sqrt(squares / freedom)
        rates = inside(ratio, runs, freedom)
        first, self._inside = self._inside == -math.inf, float(np.median(rates))
        rng = np.random.Generator(np.random.PCG64(1))
        rates += np.log1p(-rng.beta(self._other[0], self._other[1], DRAWS))
        if np.mean(rates >= math.log(rate)) >= BELIEF:
            shown = f"at least {rate:.0%} will ({BELIEF:.0%} probable)"
            self.complete = f"{said}, well inside the limits: {shown}"
        elif first and (enough - self.successes) * self._inside < math.log(0.5):
            # It would more likely fail before. But the first that is no better than others is kept.
            if self._inside <= self._reached:
                return said
            self.z = None
            return f"{said}, but with too small margins: a better one is sought"
        return said
