# SPDX-License-Identifier: Apache-2.0
"""The study of easy and hard ground: what differs from the novice, and its figures."""

import math
from typing import Any

import numpy as np
import pytest

from reproduction.rivals.learners import RIVALS
from reproduction.studies import grounds
from reproduction.studies.flip_sessions import HELD_OUT, stand_in, teach
from wam_power_ros.practice.settings import preset


def test_learners_of_a_ground_differ_only_in_the_learner_and_what_it_is_told() -> None:
    assert not {7001, grounds.FIRST} & set(HELD_OUT)
    found = grounds.TABLE.jobs([1], ["novice"], list(grounds.LEARNERS))
    own = {"task_settings", "learner", "learner_settings", "practice"}
    blank = {"name": "", "changes": 0}
    searched = ("model_based", "hindsight", "power")
    plain = preset("flip", "hindsight", **found[0].arguments["changes"])
    for job, (learner, row) in zip(found, grounds.LEARNERS.items(), strict=True):
        assert {**job.arguments, **blank} == {**found[0].arguments, **blank}
        settings = preset("flip", job.arguments["name"], **job.arguments["changes"])
        assert settings.model_dump(exclude=own) == plain.model_dump(exclude=own)
        assert settings.practice.budget == plain.practice.budget
        assert settings.practice.retests == plain.practice.retests
        assert learner not in searched or settings.practice == plain.practice
        named = job.arguments["changes"].get("learner")
        assert named in (None, {"name": RIVALS.get(learner, learner)})
        task = settings.task_settings
        blind = not task.gain
        assert ("rotation" in row.told) == (not blind)


@pytest.mark.parametrize(
    ("ground", "tilt", "roll"),
    [
        ("10 degrees of tilt", 10.0, 0.0),
        ("rolled by 3 degrees", 25.0, 3.0),
    ],
)
def test_a_demonstration_begins_with_the_pan_as_the_ground_says(
    ground: str, tilt: float, roll: float
) -> None:
    environment = stand_in(1, **grounds.GROUNDS[ground].get("condition", {}))
    (policy,) = teach(environment, 1, 1)
    rotation = environment.arm.tool_pose(policy.q_start)[1]
    assert math.degrees(math.asin(rotation[0, 2])) == pytest.approx(tilt, abs=3.0)
    assert abs(math.degrees(math.asin(rotation[2, 1]))) == pytest.approx(roll, abs=1.0)


def test_a_habit_changes_the_demonstration() -> None:
    plain, twisted, slow = (
        teach(stand_in(1), 1, 1, habit=each)[0] for each in ("", "late twist", "slow")
    )
    usual = 1.15 * plain.basis.duration
    assert twisted.basis.duration <= usual < slow.basis.duration
    assert not np.allclose(twisted.rotation_attractors, plain.rotation_attractors, atol=0.02)


def a_session(
    true: int,
    ended_by: str,
    used: int,
    first: bool = False,
    landed: int = 30,
) -> dict[str, Any]:
    return {
        "carried": {},
        "used": used,
        "ended_by": ended_by,
        "confirmed": 10 if ended_by == "confirmation" else 0,
        "trials": [{"true_flip": first}],
        "retests": [{"true_flip": k < true, "landed": k < landed} for k in range(30)],
    }


def test_the_statistics_of_a_row_count_sessions_and_not_rollouts() -> None:
    sessions = [
        a_session(30, "confirmation", 20),
        a_session(27, "confirmation", 30, first=True),
        a_session(24, "confirmation", 50),
        a_session(0, "budget", 60, landed=26),
    ]
    found = grounds.line(sessions)
    assert found["landed"] == 3  # turned over and caught, however far in the air
    assert (found["sessions"], found["reproduced"], found["solved"]) == (4, 1, 2)
    assert found["confirmed"] == 3 and found["to_streak"] == 20.0  # ten confirm
    assert found["wrong"] == 1 and found["rollouts"] == (40.0, 60.0)
    assert found["true"][0] == 0.675 and 0.0 <= found["true"][1] < 0.3
    assert grounds.line([a_session(0, "budget", 60)])["to_streak"] is None
