# SPDX-License-Identifier: Apache-2.0
"""What the arm may try of what a learner wants."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from toss_task import demonstrated_policy

from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.power import Power
from wam_power_ros.practice.feasible_sampler import HALVINGS_MAX, REDRAWS_MAX, Permission
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.parametrization import flip_parametrization

SETTINGS = preset("flip")
PARAMETERS = flip_parametrization(demonstrated_policy("flick-1", seed=1), "planar", SETTINGS.noise)
RAN = np.zeros(PARAMETERS.size)
RIGHT = np.eye(PARAMETERS.size)[PARAMETERS.groups["catch_shift"].start]  # catches further out


def never(policy: Policy) -> str:
    raise AssertionError(f"asked about {policy.id}")


def place(policy: Policy) -> float:
    return float(policy.attractors[-1, 0])


def learner(seed: int) -> Power:
    return Power(PARAMETERS.size, SETTINGS.power, np.random.default_rng(seed))


@pytest.mark.requirement("S-31")
@given(share=st.floats(0.02, 1.2), far=st.floats(0.5, 2.0))
def test_what_is_forbidden_is_drawn_back_no_further_than_it_must(share: float, far: float) -> None:
    z = far * RIGHT
    end, begin = (place(PARAMETERS.policy(point, "asked")[0]) for point in (z, RAN))
    limit = begin + share * (end - begin)
    permission = Permission(PARAMETERS, lambda policy: "too far" * (place(policy) > limit))
    given_back, halved = permission.drawn_back(z, RAN)
    assert place(PARAMETERS.policy(given_back, "allowed")[0]) <= limit
    assert np.array_equal(given_back, z) == (halved == 0) == (share >= 1.0)
    if halved not in (0, HALVINGS_MAX):
        assert place(PARAMETERS.policy(2.0 * given_back, "one-less")[0]) > limit
    again, _ = Permission(PARAMETERS, never).drawn_back(z, RAN, halved)
    assert np.array_equal(again, given_back)


@pytest.mark.requirement("S-31")
@given(seed=st.integers(0, 1000), share=st.sampled_from([0.0, 0.5, 0.9, 1.0]))
def test_a_sample_is_allowed_or_what_ran_and_its_count_brings_it_back(
    seed: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    verdicts: dict[float, bool] = {}

    def forbidden(policy: Policy) -> str:
        return "no" * verdicts.setdefault(place(policy), bool(rng.random() < share))

    once, twice = learner(seed), learner(seed)
    z, count = Permission(PARAMETERS, forbidden).sample(once, RAN)
    assert np.array_equal(z, RAN) or not forbidden(PARAMETERS.policy(z, "tried")[0])
    assert (share < 1.0) or count == REDRAWS_MAX + HALVINGS_MAX
    again, _ = Permission(PARAMETERS, never).sample(twice, RAN, count)
    assert np.array_equal(again, z)
    assert np.array_equal(once.ask(), twice.ask())  # both have drawn as often
