# SPDX-License-Identifier: Apache-2.0
"""What the rollouts of a session so far tell: the best demonstration, the best policy, what ran.

Each function goes through all records, oldest first, with the ratings that have taken effect. They
are asked before a rollout is executed or after it, not for the lines of a log that is replayed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.session_log import Record


@dataclass(frozen=True)
class Best:
    """Current answer of a session."""

    policy: Policy  # named after the first trial that ran it
    returns: tuple[float, ...]  # of its runs without exploration
    successes: int  # number of these runs that succeeded
    why: str  # human-readable reason for the choice


def choose_best(
    records: Sequence[Record],
    parametrizations: Mapping[str, Parametrization],
    demonstration: str | None,
    answer: np.ndarray | None,
    stopped: str,
    return_noise: float,
) -> Best | None:
    """Best policy so far; None before a usable run.

    Only runs without exploration count: reproductions, means and re-tests, so that a lucky
    exploration is never chosen, and no policy that a person refused. While learning, the policy
    with the highest lower bound is chosen among those of the current demonstration; the later one
    wins a tie. Once the session has stopped, its answer is chosen.

    `parametrizations` are by the ids of demonstrations, of which `demonstration` is the current
    one, None before the choice. `answer` are the coordinates of the session's answer, shape
    (size,), None while learning; `stopped` is the reason why learning stopped, `return_noise` the
    standard deviation of the return of one policy.
    """
    refused = {record.executed for record in records if record.refused}
    runs_of: dict[tuple[str, tuple[float, ...]], list[Record]] = {}  # in the order of first runs
    for record in records:
        usable = record.ret is not None and record.kind != "explore"
        current = demonstration in (None, record.demonstration)
        if usable and current and record.executed not in refused:
            runs_of.setdefault(record.executed, []).append(record)
    if not runs_of:
        return None
    known = [*runs_of.values()]

    def bound(runs: Sequence[Record]) -> float:
        return lower_bound([r.rated_return or 0.0 for r in runs], return_noise)

    if answered := [r for r in known if answer is not None and r[0].z == answer.tolist()]:
        best, rule = answered[0], f"the final policy: {stopped}"
    else:
        best = max(reversed(known), key=bound)
        rule = f"lower bound {bound(best):.3f}, highest of {len(known)} policies"
    first, successes = best[0], sum(record.succeeded for record in best)
    returns = tuple(record.rated_return or 0.0 for record in best)
    policy, _ = parametrizations[first.demonstration].policy(np.array(first.z), first.id)
    why = (
        f"{first.id}: {successes} of {len(best)} runs without exploration succeeded, "
        f"mean return {np.mean(returns):.3f}; {rule}"
    )
    return Best(policy, returns, successes, why)


def lower_bound(returns: Sequence[float], return_noise: float) -> float:
    """Mean return minus its standard error; `return_noise` is the sd of a single return."""
    return float(np.mean(returns)) - return_noise / math.sqrt(len(returns))


def limit_stops(records: Sequence[Record]) -> int:
    """Number of rollouts in which the arm exceeded a limit that its model had kept."""
    # Such a fault has a return of 0, any other has none.
    return sum(bool(r.fault) and r.ret is not None and not r.refused for r in records)


def ended_by_fault(records: Sequence[Record], demonstration: str) -> list[list[float]]:
    """Coordinates at which a fault or a person ended a rollout, and gave it the return 0."""
    # All re-tests are of one policy, so a fault in one of them changes none of the others.
    return [
        r.z
        for r in records
        if r.demonstration == demonstration
        and r.ret is not None
        and (r.refused or (r.fault and r.kind != "retest"))
    ]


def best_without_fault(records: Sequence[Record], demonstration: str) -> Record | None:
    """Rollout with the highest return of a demonstration, the first of equals.

    Only of policies that no fault has ended: one that is just within a limit of the arm would be
    executed again and again, and end in a fault every second time.
    """
    ended = ended_by_fault(records, demonstration)
    ran = (r for r in records if r.demonstration == demonstration and not r.fault)
    usable = (r for r in ran if r.ret is not None and r.z not in ended)
    return max(usable, key=lambda r: r.rated_return or 0.0, default=None)


def reproduction_learnt_from(records: Sequence[Record]) -> Record | None:
    """Reproduction of the current demonstration; None before the demonstration is chosen."""
    practised = [record.demonstration for record in records if record.kind != "reproduction"]
    usable = (r for r in records if r.kind == "reproduction" and r.ret is not None)
    return next((r for r in usable if practised and r.demonstration == practised[-1]), None)


def choose_demonstration(reproductions: Sequence[Record]) -> tuple[Record | None, str]:
    """Choose the reproduction with the highest return, including ratings; the first one on a tie.

    The authors selected one good demonstration of a small series ([Kormushev2010], Sec. IV). One
    without a return or with a fault is not eligible.

    Returns:
        The reproduction, None if none is eligible, and a human-readable reason.
    """
    eligible = [r for r in reproductions if r.ret is not None and not r.fault]
    if not eligible:
        reasons = "; ".join(f"{record.demonstration}: {record.why}" for record in reproductions)
        return None, f"no demonstration could be reproduced ({reasons})"
    best = max(eligible, key=lambda record: record.rated_return or 0.0)
    count = len(reproductions)
    rank = f"highest return of {count} reproductions" if count > 1 else "the only reproduction"
    return best, f"{rank}, {best.rated_return:.3f}"
