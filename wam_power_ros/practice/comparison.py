# SPDX-License-Identifier: Apache-2.0
"""Which of two policies is better, by pairs of rollouts, however often one looks.

The first of a pair is executed by turns, so that what drifts favours neither. A pair is won by the
success, of two alike by the higher return; one that is equal, or has a rollout without a return,
counts for neither. If no policy were better, each would win with a probability of a half at most.
The evidence against that is the likelihood of the wins, averaged over all larger probabilities and
relative to that of a half. It is a nonnegative martingale with a mean of one, so it ever exceeds
1 / e with a probability of at most e (Ville's inequality): one may stop at any time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.special import betainc, betaln

from wam_power_ros.tasks.task import Assessment

ERROR = 0.05  # probability of a wrong answer, at most; one half for each policy
DECIDED = 2.0 / ERROR  # evidence that decides


def evidence(wins: int, losses: int) -> float:
    """Evidence [1] that a policy with these pairs won and lost wins with more than a half."""
    n, tail = wins + losses, 1.0 - betainc(wins + 1.0, losses + 1.0, 0.5)
    return float(np.exp((n + 1) * np.log(2.0) + betaln(wins + 1.0, losses + 1.0)) * tail)


@dataclass
class Comparison:
    """Pairs of rollouts of two policies, 0 and 1.

    Attributes:
        won: Pairs that each has won.
        alike: Pairs that count for neither.
        better: The better policy; None while that is not known.
    """

    won: list[int] = field(default_factory=lambda: [0, 0])
    alike: int = 0
    better: int | None = None

    @property
    def pairs(self) -> int:
        """Number of pairs."""
        return sum(self.won) + self.alike

    @property
    def order(self) -> tuple[int, int]:
        """Policies of the next pair, in the order of execution."""
        return (0, 1) if self.pairs % 2 == 0 else (1, 0)

    @property
    def evidence(self) -> float:
        """Evidence [1] for the policy that has won more pairs; `DECIDED` decides."""
        return evidence(max(self.won), min(self.won))

    def add(self, found: tuple[Assessment, Assessment]) -> None:
        """Judge a pair: the assessments of policies 0 and 1."""
        ranks = [(each.success, each.ret) for each in found]
        if any(each.ret is None for each in found) or ranks[0] == ranks[1]:
            self.alike += 1
            return
        self.won[ranks.index(max(ranks))] += 1
        if self.better is None and self.evidence >= DECIDED:
            self.better = self.won.index(max(self.won))
