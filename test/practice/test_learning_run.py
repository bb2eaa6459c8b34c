# SPDX-License-Identifier: Apache-2.0
"""Infeasible samples are rejected or shrunk."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toss_task import AnyArm, demonstrated_policy

from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.power import Power
from wam_power_ros.practice.learning_run import (
    HALVINGS_MAX,
    REJECTIONS_MAX,
    feasibility,
    sample,
    shrink,
)
from wam_power_ros.practice.settings import preset

SETTINGS = preset("flip")
PARAMETERS = SETTINGS.make_task({}).parametrization(demonstrated_policy("flick-1", seed=1))
RAN = np.zeros(PARAMETERS.size)
RIGHT = np.eye(PARAMETERS.size)[PARAMETERS.groups["catch_shift"].start]  # catches further out


def never(z: np.ndarray) -> bool:
    raise AssertionError(f"simulated {z}")


def feasible(refuse: Callable[[Policy], str]) -> Callable[[np.ndarray], bool]:
    return feasibility(PARAMETERS, AnyArm(refuse), 0, "sample")


def place(policy: Policy) -> float:
    return float(policy.attractors[-1, 0])


def learner(seed: int) -> Power:
    return Power(PARAMETERS.size, SETTINGS.learner_settings, np.random.default_rng(seed))


@pytest.mark.requirement("S-31")
@settings(max_examples=30)
@given(share=st.floats(0.02, 1.2), far=st.floats(0.5, 2.0))
def test_what_is_infeasible_is_shrunk_no_further_than_needed(share: float, far: float) -> None:
    z = far * RIGHT
    end, begin = (place(PARAMETERS.policy(point, "asked")[0]) for point in (z, RAN))
    limit = begin + share * (end - begin)
    is_feasible = feasible(lambda policy: "too far" * (place(policy) > limit))
    given_back, halved = shrink(z, RAN, is_feasible)
    assert place(PARAMETERS.policy(given_back, "allowed")[0]) <= limit
    assert np.array_equal(given_back, z) == (halved == 0) == (share >= 1.0)
    if halved < HALVINGS_MAX:
        np.testing.assert_allclose(given_back, RAN + 0.5**halved * (z - RAN))
    if halved not in (0, HALVINGS_MAX):
        assert place(PARAMETERS.policy(2.0 * given_back, "one-less")[0]) > limit


@pytest.mark.requirement("S-31")
@settings(max_examples=30)
@given(seed=st.integers(0, 1000), share=st.sampled_from([0.0, 0.5, 0.9, 1.0]))
def test_a_sample_is_feasible_or_what_ran_and_its_count_restores_it(
    seed: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    verdicts: dict[float, bool] = {}

    def infeasible(policy: Policy) -> str:
        return "no" * verdicts.setdefault(place(policy), bool(rng.random() < share))

    once, twice = learner(seed), learner(seed)
    z, count = sample(once, lambda: RAN, feasible(infeasible))
    assert np.array_equal(z, RAN) or not infeasible(PARAMETERS.policy(z, "tried")[0])
    assert (share < 1.0) or count == REJECTIONS_MAX + HALVINGS_MAX
    again, _ = sample(twice, lambda: RAN, never, count)
    assert np.array_equal(again, z)
    assert np.array_equal(once.ask(), twice.ask())  # both have drawn as often
