# SPDX-License-Identifier: Apache-2.0
"""Runs of learners on a reach: reproducible, and better than the demonstration."""

import numpy as np
import pytest

from reproduction.studies.reaching_runs import (
    NOISE,
    study,
    synthetic,
)
from wam_power_ros.learning.parametrization import parametrization_of
from wam_power_ros.learning.policy import Policy

SCENARIO = synthetic()
FULL = parametrization_of(SCENARIO.policy, "full", NOISE["full"])


def evaluated(policy: Policy) -> float:
    """Return of a policy (Eq. 4)."""
    ret, _ = SCENARIO.evaluate(policy.stiffness[np.newaxis], policy.attractors[np.newaxis])
    return float(ret[0])


def test_the_same_seeds_learn_the_same_and_others_do_not() -> None:
    once, again = (study("full", [3, 4], 10, SCENARIO) for _ in range(2))
    for first, second in zip(once, again, strict=True):
        np.testing.assert_array_equal(first.returns, second.returns)
        np.testing.assert_array_equal(first.mean, second.mean)
    assert once[0].final != once[1].final


@pytest.mark.parametrize("variant", ["full", "diagonal"])
def test_power_gets_far_beyond_the_demonstration(variant: str) -> None:
    start = evaluated(SCENARIO.policy)
    final = [run.final for run in study(variant, range(10), 60, SCENARIO)]
    assert np.mean(final) > start + 0.15
