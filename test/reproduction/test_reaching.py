# SPDX-License-Identifier: Apache-2.0
"""Reaching taught on the arm and executed by it, and the chapter of the reaching study."""

import numpy as np
import pytest

from reproduction.studies import reaching_arm
from reproduction.studies.reaching import TUNING


def test_the_shipped_demonstrations_make_a_scenario_of_the_arm() -> None:
    scenario = reaching_arm.taught_scenario()
    assert scenario.demonstrations.shape == (4, 200, 3)
    way = scenario.demonstrated[-1] - scenario.start
    assert np.linalg.norm(way) == pytest.approx(0.5, abs=0.05)
    policy = scenario.policy
    stiffness, attractors = policy.stiffness[np.newaxis], policy.attractors[np.newaxis]
    assert scenario.evaluate(stiffness, attractors)[1][0]
    free = scenario.free_paths(stiffness, attractors)[0]
    assert np.linalg.norm(free[-1] - scenario.demonstrated[-1]) < 0.04


def test_a_learnt_reach_is_executed_near_its_plan() -> None:
    result = reaching_arm.executed_run("full", TUNING[0], 10)
    assert result["fault"] == ""
    assert result["rms"] < 0.06
    assert len(result["planned"]) == len(result["executed"])
