# SPDX-License-Identifier: Apache-2.0
"""CMA-ES."""

import numpy as np
import pytest
from hill_task import SIZE, climb, rng

from wam_power_ros.learning.cma_es import CmaEs


def test_the_mean_moves_once_a_generation() -> None:
    learner = climb(CmaEs(SIZE, CmaEs.Settings(population=7), rng(0)), 6)
    assert not learner.mean.any()
    assert climb(learner, 1).mean.any()


def test_samples_come_from_the_generator_that_is_passed_in() -> None:
    settings = CmaEs.Settings()
    first, same, other = (CmaEs(SIZE, settings, rng(seed)).ask() for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert not np.array_equal(first, other)


def test_it_needs_two_parameters() -> None:
    with pytest.raises(ValueError, match="at least 2"):
        CmaEs(1, CmaEs.Settings(), rng(0))
