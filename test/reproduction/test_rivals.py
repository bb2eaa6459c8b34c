# SPDX-License-Identifier: Apache-2.0
"""Learners that others use, beside the package's own."""

import numpy as np
from hill_task import SIZE, climb, rng

from reproduction.rivals.learners import Pi2


def test_the_mean_moves_once_a_population_and_the_noise_decays_with_it() -> None:
    settings = Pi2.Settings(population=4, decay=0.5)
    learner = climb(Pi2(SIZE, settings, rng(0)), 3)
    assert not learner.mean.any()
    mean = climb(learner, 1).mean
    assert mean.any()
    source = rng(0)
    source.standard_normal((4, SIZE))
    np.testing.assert_array_equal(learner.ask(), mean + 0.5 * source.standard_normal(SIZE))


def test_the_weights_are_those_of_the_formula() -> None:
    z, returns = rng(1).standard_normal((5, SIZE)), np.array([0.1, 0.9, 0.4, 0.2, 0.6])
    learner = Pi2(SIZE, Pi2.Settings(population=5, eliteness=3.0), rng(0))
    for offset in (0.0, 1000.0):  # a level that all returns share does not matter
        for one, ret in zip(z + offset, returns + offset, strict=True):
            learner.tell(one, float(ret))
        weights = np.exp(3.0 * (returns - 0.9) / 0.8)
        np.testing.assert_allclose(learner.mean, np.average(z, axis=0, weights=weights) + offset)
