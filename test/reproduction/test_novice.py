# SPDX-License-Identifier: Apache-2.0
"""The study of a novice's toss: the same sessions for every learner, and their statistics."""

import math
from typing import Any

import pytest

from reproduction.studies import novice
from reproduction.studies.flip_sessions import HELD_OUT, stand_in, teach
from wam_power_ros.practice.settings import preset


def test_rows_differ_only_in_the_learner_and_its_information() -> None:
    found = novice.jobs([1, 2])
    assert {job.arguments["seed"] for job in found} == {1, 2}
    assert not set(novice.HELD_OUT) & set(HELD_OUT)
    own = {"task_settings", "learner", "learner_settings", "practice"}
    blank = {"seed": 0, "name": "", "changes": 0, "carried": 0, "repeats": 0}
    plain = preset("flip", "hindsight", **found[0].arguments["changes"])
    for job in found:
        assert {**job.arguments, **blank} == {**found[0].arguments, **blank}
        settings = preset("flip", job.arguments["name"], **job.arguments["changes"])
        assert settings.model_dump(exclude=own) == plain.model_dump(exclude=own)
        assert settings.practice.budget == plain.practice.budget
        assert settings.practice.retests == plain.practice.retests
        task = settings.task_settings
        blind = not any(
            (task.landing_gain, task.level_gain, task.turn_gain, task.vigour_gain, task.tempo_gain)
        )
        assert ("rotation" in novice.ROWS[job.study.removeprefix("novice-")].told) == (not blind)


def test_every_case_is_a_study_of_its_own() -> None:
    found = [job for case in novice.CASES for job in novice.jobs([1], ["hindsight"], case)]
    assert len({job.study for job in found}) == len(found) == len(novice.CASES)
    assert len({str(job.arguments) for job in found}) == len(found)


def test_a_demonstration_from_a_level_pan_begins_level() -> None:
    for level, tilt in ((False, 25.0), (True, 0.0)):
        environment = stand_in(1, level=level)
        (policy,) = teach(environment, 1, 1)
        normal = environment.arm.tool_pose(policy.q_start)[1][:, 2]
        assert math.degrees(math.acos(normal[2])) == pytest.approx(tilt, abs=3.0)


def a_session(
    true: int,
    ended_by: str,
    used: int,
    first: bool = False,
    elsewhere: int | None = None,
    landed: int = 30,
) -> dict[str, Any]:
    carried = [] if elsewhere is None else [{"true_flip": k < elsewhere} for k in range(30)]
    return {
        "carried": {"elsewhere": carried} if carried else {},
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
    found = novice.line(sessions)
    assert found["landed"] == 3  # turned over and caught, however far in the air
    assert (found["sessions"], found["reproduced"], found["solved"]) == (4, 1, 2)
    assert found["confirmed"] == 3 and found["to_streak"] == 20.0  # ten confirm
    assert found["wrong"] == 1
    assert found["true"][0] == 0.675 and 0.0 <= found["true"][1] < 0.3
    assert novice.line([a_session(0, "budget", 60)])["to_streak"] is None


def test_the_statistics_of_other_worlds_are_separate() -> None:
    found = novice.line([a_session(30, "confirmation", 20, elsewhere=k) for k in (15, 30)])
    assert found["true"][0] == 1.0 and found["elsewhere"][0] == 0.75
    assert found["elsewhere"][1] == pytest.approx(0.55)
    assert novice.line([a_session(30, "confirmation", 20)])["elsewhere"] is None
