# SPDX-License-Identifier: Apache-2.0
"""Rollouts of a session so far, with summaries that are kept up to date by each of them.

So the next trial, and each line of a resumed session, costs the same after any number of rollouts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from wam_power_ros.practice.session_log import Record


@dataclass
class Runs:
    """Runs of one policy without exploration.

    Attributes:
        id: Id of the first run.
        demonstration: Id of the candidate that the policy was derived from.
        z: Coordinates of the policy. Shape (size,).
        returns: Returns of the runs, including ratings.
        mean: Mean of the returns.
        successes: Number of runs that succeeded.
    """

    id: str
    demonstration: str
    z: np.ndarray
    returns: list[float] = field(default_factory=list)
    mean: float = 0.0
    successes: int = 0

    def add(self, ret: float, succeeded: bool) -> None:
        """Count a run."""
        self.returns.append(ret)
        self.mean = float(np.mean(self.returns))
        self.successes += succeeded

    def lower_bound(self, return_noise: float) -> float:
        """Mean return minus its standard error; `return_noise` is the sd of a single return."""
        return self.mean - return_noise / math.sqrt(len(self.returns))


class Past:
    """Rollouts so far.

    Attributes:
        records: The rollouts, oldest first, with the ratings that have taken effect.
        overruns: Number of rollouts in which the arm exceeded a limit that its model had kept.
    """

    def __init__(self, records: Sequence[Record] = ()) -> None:
        """Begin after some rollouts."""
        self.records: list[Record] = []
        self.overruns = 0
        self._runs: dict[tuple[str, bytes], Runs] = {}  # in the order of first runs
        self._best: dict[str, Record] = {}
        self._faulted: set[tuple[str, tuple[float, ...]]] = set()  # demonstrations, coordinates
        self._refused: set[tuple[str, tuple[float, ...]]] = set()
        for record in records:
            self.add(record)

    def add(self, record: Record) -> None:
        """Append a rollout."""
        self.records.append(record)
        # A fault with return 0 is a limit that the model had kept; others leave no return.
        self.overruns += bool(record.fault) and record.ret is not None and not record.refused
        ret, name = record.rated_return, record.demonstration
        if ret is None:
            return
        if record.refused:
            self._refused.add((name, tuple(record.z)))
        # All re-tests are of one policy, so a fault in one of them changes none of the others.
        ended = record.refused or (bool(record.fault) and record.kind != "retest")
        if ended:
            self._faulted.add((name, tuple(record.z)))
            self._best.pop(name, None)  # it may have been the policy of the best
        for each in self.records if ended else (record,):
            self._compare(each)
        if record.kind != "explore":
            z = np.array(record.z)
            runs = self._runs.setdefault((name, z.tobytes()), Runs(record.id, name, z))
            runs.add(ret, record.succeeded)

    def rated(self, number: int, amount: float) -> Past:
        """These rollouts, one of them with a further rating."""
        records = list(self.records)
        records[number - 1] = records[number - 1].with_rating(amount)
        return Past(records)

    def best_without_fault(self, demonstration: str) -> Record | None:
        """Rollout with the highest return of a demonstration, the first of equals.

        Only of policies that no fault has ended: one that is just within a limit of the arm would
        be executed again and again, and end in a fault every second time.
        """
        return self._best.get(demonstration)

    def ended_in_fault(self, demonstration: str, z: Sequence[float]) -> bool:
        """Whether a fault ended a rollout at z (size,) in practice, and gave it the return 0."""
        return (demonstration, tuple(z)) in self._faulted

    def refused(self, demonstration: str, z: Sequence[float]) -> bool:
        """Whether a person has ended a rollout at z (size,): this policy is not run again."""
        return (demonstration, tuple(z)) in self._refused

    def _compare(self, record: Record) -> None:
        name, ret = record.demonstration, record.rated_return
        if ret is None or record.fault or self.ended_in_fault(name, record.z):
            return
        best = self._best.get(name)
        if best is None or ret > (best.rated_return or 0.0):
            self._best[name] = record

    def runs_without_exploration(self, demonstration: str | None) -> list[Runs]:
        """Runs by policy that no person refused, of one demonstration or of all, oldest first."""
        runs = (r for r in self._runs.values() if demonstration in (None, r.demonstration))
        return [r for r in runs if not self.refused(r.demonstration, r.z.tolist())]
