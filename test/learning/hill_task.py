# SPDX-License-Identifier: Apache-2.0
"""Return with a single peak, for tests of the learners."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from wam_power_ros.learning.learner import Learner

SIZE = 6
TOP = np.full(SIZE, 0.8)
L = TypeVar("L", bound=Learner)


def rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def hill(z: np.ndarray) -> float:
    return float(np.exp(-0.3 * ((z - TOP) ** 2).sum()))


def climb(learner: L, rollouts: int) -> L:
    for _ in range(rollouts):
        z = learner.ask()
        learner.tell(z, hill(z))
    return learner
