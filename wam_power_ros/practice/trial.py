# SPDX-License-Identifier: Apache-2.0
"""Trials: rollouts to be executed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.session_log import Kind, Record


@dataclass(frozen=True)
class Draw:
    """Coordinates selected for the next trial.

    Attributes:
        kind: "reproduction" of a demonstration, "explore", "mean" or "retest" (not learnt from).
        demonstration: Id of the candidate that the coordinates refer to.
        z: Coordinates. Shape (size,).
        attempt: 1, or more after rollouts of the same z without a return.
        rejections: Number of infeasible samples before this one, plus the number of halvings after
            20 of them; for a mean or an answer the number of halvings, see `feasible_sampler`.
        purpose: Human-readable purpose of the trial.
    """

    kind: Kind
    demonstration: str
    z: np.ndarray
    attempt: int
    rejections: int
    purpose: str


@dataclass(frozen=True)
class Trial(Draw):
    """A rollout to be executed.

    Attributes:
        number: Position in the session, from 1.
        id: Name of the rollout and of its policy, "trial-0007".
        policy: Policy to execute, at the coordinates z.
        theta: Its learnt parameters in physical units. Shape (size,).
    """

    number: int
    id: str
    policy: Policy
    theta: np.ndarray


def check_record(trial: Trial, record: Record, generator: dict[str, Any]) -> None:
    """Check that a logged record belongs to a trial.

    Args:
        trial: Trial that is due.
        record: Record as logged.
        generator: State of the session's generator after the trial was drawn.

    Raises:
        ValueError: The record belongs to another trial; names the first difference.
    """
    for name in ("number", "id", "kind", "demonstration", "attempt"):
        wanted, got = getattr(trial, name), getattr(record, name)
        if wanted != got:
            raise ValueError(
                f"record {trial.number}: {name} is {got!r}, expected {wanted!r} in this session: "
                "other settings, seed or candidates?"
            )
    same_z = len(record.z) == len(trial.z) and np.allclose(record.z, trial.z, rtol=0, atol=1e-6)
    if not same_z or record.generator != generator:
        raise ValueError(
            f"record {record.number}: {'the generator' if same_z else 'z'} is not this "
            "session's: other settings, seed or candidates?"
        )
