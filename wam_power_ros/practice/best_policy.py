# SPDX-License-Identifier: Apache-2.0
"""The best demonstration, and the best policy, judged by their runs without exploration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.past import Past
from wam_power_ros.practice.session_log import Record


@dataclass(frozen=True)
class Best:
    """Current answer of a session.

    Attributes:
        policy: The policy, named after the first trial that ran it.
        returns: Returns of its runs without exploration.
        successes: Number of these runs that succeeded.
        why: Human-readable reason for the choice.
    """

    policy: Policy
    returns: tuple[float, ...]
    successes: int
    why: str


def choose_best(
    past: Past,
    parametrizations: Mapping[str, Parametrization],
    demonstration: str | None,
    answer: np.ndarray | None,
    stopped: str,
    return_noise: float,
) -> Best | None:
    """Best policy so far; None before a usable run.

    Only runs without exploration count: reproductions, means and re-tests, so that a lucky
    exploration is never chosen. While learning, the policy with the highest lower bound is chosen
    among those of the current demonstration; the later one wins a tie. Once the session has
    stopped, its answer is chosen.

    Args:
        past: Rollouts of the session.
        parametrizations: Parametrizations of the demonstrations, by id.
        demonstration: Id of the current demonstration, None before the choice.
        answer: Coordinates of the session's answer, None while learning. Shape (size,).
        stopped: Reason why learning stopped.
        return_noise: Standard deviation of the return of one policy.
    """
    known = past.runs_without_exploration(demonstration)
    if not known:
        return None
    answers = [runs for runs in known if answer is not None and (runs.z == answer).all()]
    if answers:
        best, rule = answers[0], f"the final policy: {stopped}"
    else:
        best = max(reversed(known), key=lambda runs: runs.lower_bound(return_noise))
        rule = f"lower bound {best.lower_bound(return_noise):.3f}, highest of {len(known)} policies"
    policy, _ = parametrizations[best.demonstration].policy(best.z, best.id)
    why = (
        f"{best.id}: {best.successes} of {len(best.returns)} runs without exploration succeeded, "
        f"mean return {best.mean:.3f}; {rule}"
    )
    return Best(policy, tuple(best.returns), best.successes, why)


def reproduction_learnt_from(records: Sequence[Record]) -> Record | None:
    """Reproduction of the current demonstration; None before the demonstration is chosen."""
    practised = [record.demonstration for record in records if record.kind != "reproduction"]
    usable = (r for r in records if r.kind == "reproduction" and r.ret is not None)
    return next((r for r in usable if practised and r.demonstration == practised[-1]), None)


def choose_demonstration(reproductions: Sequence[Record]) -> tuple[int, str]:
    """Choose the reproduction with the highest return, including ratings.

    The authors selected one good demonstration of a small series ([Kormushev2010], Sec. IV).

    Args:
        reproductions: One record for each candidate; those without a return or with a fault are not
            eligible.

    Returns:
        Index into `reproductions`, the first one on a tie, and a human-readable reason.

    Raises:
        ValueError: No reproduction is eligible.
    """
    eligible = [
        index
        for index, record in enumerate(reproductions)
        if record.rated_return is not None and not record.fault
    ]
    if not eligible:
        reasons = "; ".join(f"{record.demonstration}: {record.why}" for record in reproductions)
        raise ValueError(f"no demonstration could be reproduced ({reasons})")
    best = max(eligible, key=lambda index: float(reproductions[index].rated_return or 0.0))
    count = len(reproductions)
    rank = f"highest return of {count} reproductions" if count > 1 else "the only reproduction"
    return best, f"{rank}, {reproductions[best].rated_return:.3f}"
