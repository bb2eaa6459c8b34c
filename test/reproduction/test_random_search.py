# SPDX-License-Identifier: Apache-2.0
"""Random search."""

import numpy as np
from hill_task import SIZE, hill, rng

from reproduction.rivals.learners import RandomSearch


def test_random_search_keeps_the_best_rollout() -> None:
    learner = RandomSearch(SIZE, RandomSearch.Settings(), rng(0))
    assert not learner.mean.any()
    samples = [learner.ask() for _ in range(50)]
    for z in samples:
        learner.tell(z, hill(z))
    np.testing.assert_array_equal(learner.mean, max(samples, key=hill))
