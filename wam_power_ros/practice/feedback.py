# SPDX-License-Identifier: Apache-2.0
"""User input during a session: ratings of rollouts, and further demonstrations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wam_power_ros import plain_json
from wam_power_ros.learning.policy import Policy, to_json
from wam_power_ros.practice.session_log import Event, NewDemonstration, Rating, Record, plain

RATING_MAX = 1.0  # magnitude of one rating; returns are of this order


def make_rating(
    records: Sequence[Record],
    waiting: Sequence[Event],
    after: int,
    amount: float,
    number: int | None = None,
    clock: Mapping[str, Any] | None = None,
) -> Rating:
    """Create the log line of a rating.

    Args:
        records: Rollouts of the session, with the ratings that have taken effect.
        waiting: Events that have not taken effect yet.
        after: Number of recorded rollouts when it takes effect.
        amount: Amount added to the return; several ratings of a rollout add up.
        number: Number of the rollout, the last finished one when omitted.
        clock: Wall-clock figures, logged only.

    Raises:
        ValueError: The amount is out of range, or the rollout does not exist or has no return.
    """
    if not (np.isfinite(amount) and 0.0 < abs(amount) <= RATING_MAX):
        raise ValueError(f"a rating must be within ±{RATING_MAX} and not 0, got {amount}")
    if not records:
        raise ValueError("there is no finished rollout to rate yet")
    number = len(records) if number is None else number
    if not 1 <= number <= len(records):
        raise ValueError(f"rollout {number} is not one of the {len(records)} on record")
    record = records[number - 1]
    if record.rated_return is None:
        raise ValueError(f"{record.id} has no return and is not learnt from: {record.why}")
    pending = sum(e.amount for e in waiting if isinstance(e, Rating) and e.rollout == number)
    so_far = (record.adjustment or 0.0) + pending
    before, later = (max((record.ret or 0.0) + part, 0.0) for part in (so_far, so_far + amount))
    done = "rewarded" if amount > 0.0 else "punished"
    return Rating(
        after=after,
        rollout=number,
        amount=float(amount),
        note=f"{record.id} {done}: return {before:.3f} -> {later:.3f}",
        clock=plain(clock or {}),
    )


def make_demonstration(
    policy: Policy, after: int, bag: str = "", clock: Mapping[str, Any] | None = None
) -> NewDemonstration:
    """Create the log line of a further demonstration.

    Args:
        policy: Policy fitted to the demonstration.
        after: Number of recorded rollouts when it takes effect.
        bag: Bag of the demonstration, logged only.
        clock: Wall-clock figures, logged only.
    """
    return NewDemonstration(
        after=after,
        id=policy.id,
        policy=plain_json.parse(to_json(policy), policy.id),
        bag=bag,
        note=f"{policy.id} is reproduced after rollout {after}" + (f": {bag}" if bag else ""),
        clock=plain(clock or {}),
    )
