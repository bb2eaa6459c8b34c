# SPDX-License-Identifier: Apache-2.0
"""What speaks for a policy: its noise-free runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.session_log import Record


@dataclass(frozen=True)
class Best:
    """The policy a session would answer with now.

    Attributes:
        policy: the policy, named after the first trial that ran it.
        returns: returns of its noise-free runs.
        successes: number of these runs that succeeded.
        why: the evidence for it, in words.
    """

    policy: Policy
    returns: tuple[float, ...]
    successes: int
    why: str


@dataclass
class Evidence:
    """Noise-free runs of one policy.

    Attributes:
        id: name of the first of them.
        demonstration: id of the candidate it starts from.
        z: coordinates of the policy. Shape (size,)
        returns: of the runs, ratings included.
        successes: number of runs that succeeded.
    """

    id: str
    demonstration: str
    z: np.ndarray
    returns: list[float] = field(default_factory=list)
    successes: int = 0

    def lower_bound(self, return_noise: float) -> float:
        """What its return is likely to exceed, noise of one return being `return_noise`."""
        return float(np.mean(self.returns)) - return_noise / math.sqrt(len(self.returns))


def evidence_of(records: Sequence[Record]) -> list[Evidence]:
    """What is known of each policy that was run without noise, in the order of first runs.

    Args:
        records: of a session, oldest first.
    """
    found: dict[tuple[str, bytes], Evidence] = {}
    for record in records:
        if record.worth is not None and record.kind != "explore":
            z = np.array(record.z)
            default = Evidence(record.id, record.demonstration, z)
            evidence = found.setdefault((record.demonstration, z.tobytes()), default)
            evidence.returns.append(record.worth)
            evidence.successes += record.succeeded
    return list(found.values())
