# SPDX-License-Identifier: Apache-2.0
"""Reaching taught on the arm and executed by it, and the chapter of the reaching study."""

import json

import numpy as np
import pytest

from reproduction.chapters.reaching import STUDY
from reproduction.studies import reaching, reaching_arm
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


@pytest.mark.long
def test_the_reaching_chapter_is_made_of_its_quick_jobs() -> None:
    results: dict = {}
    for job in reaching.jobs("quick"):
        arguments = job.arguments | {"rollouts": 6}
        results.setdefault(job.study, {})[job.key] = job.function(**arguments)
    chapter = STUDY.chapter(json.loads(json.dumps(results)))
    assert len(chapter.figures) == 3
    words = [claim.what for claim in chapter.claims]
    assert any("stuck" in what for what in words) and any("taught" in what for what in words)
