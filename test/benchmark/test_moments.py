# SPDX-License-Identifier: Apache-2.0
"""False states at random moments: the ones whose reaction once moved the arm on."""

import numpy as np
import pytest

from benchmark.moments import inject


@pytest.mark.requirement("S-121")
@pytest.mark.parametrize("name", ["silence", "the same state again and again"])
@pytest.mark.parametrize("seed", [7000, 7001, 7003, 7005])
def test_an_arm_whose_driver_falls_silent_while_a_person_guides_it_comes_to_rest(
    name: str, seed: int
) -> None:
    outcome = inject(name, "teaching", np.random.default_rng(seed))
    assert outcome.noticed
    assert outcome.rest < 0.1
    assert outcome.after < 0.1
    assert outcome.reset


@pytest.mark.requirement("S-121")
@pytest.mark.parametrize("seed", [8, 13])
def test_an_arm_whose_joint_seems_not_to_move_is_braked_by_its_model(seed: int) -> None:
    outcome = inject("joint 2 frozen", "move", np.random.default_rng([seed, 5]))
    assert outcome.noticed
    assert outcome.rest < 0.1
    assert outcome.reset
