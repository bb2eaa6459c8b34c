# SPDX-License-Identifier: Apache-2.0
"""A rollout that is to be executed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.session_log import Kind


@dataclass(frozen=True)
class Trial:
    """A rollout to be executed.

    Attributes:
        number: position in the session, from 1.
        id: name of the rollout and of its policy, "trial-0007".
        kind: "reproduction" of a demonstration, "explore", "mean" or "retest" (not learnt from).
        demonstration: id of the candidate it starts from.
        policy: what to execute.
        z: coordinates of that policy. Shape (size,)
        theta: the same in their own units. Shape (size,)
        attempt: 1, or more when earlier rollouts of the same z could not be learnt from.
        redrawn: number of samples that were forbidden before this one; from 20 on, and for a
            mean, the times it was drawn back by half instead.
        why: what the trial is for, in words.
    """

    number: int
    id: str
    kind: Kind
    demonstration: str
    policy: Policy
    z: np.ndarray
    theta: np.ndarray
    attempt: int
    redrawn: int
    why: str


@dataclass(frozen=True)
class Retry:
    """A policy to be tried again, as nothing could be learnt from its rollout; see `Trial`."""

    kind: Kind
    demonstration: str
    z: np.ndarray
    attempt: int
    why: str
