# SPDX-License-Identifier: Apache-2.0
"""The study of ball-in-a-cup: the same sessions for every learner, and their statistics."""

from typing import Any

from reproduction.studies import ball_in_cup
from wam_power_ros.practice.settings import preset


def test_rows_differ_only_in_the_learner_and_its_information() -> None:
    found = ball_in_cup.TABLE.jobs([1, 2], ["novice"], list(ball_in_cup.LEARNERS))
    blank = {"seed": 0, "name": "", "changes": 0}
    assert {job.arguments["seed"] for job in found} == {1, 2}
    plain = preset("ball_in_cup", retests=ball_in_cup.RETESTS).practice
    for job in found:
        assert {**job.arguments, **blank} == {**found[0].arguments, **blank}
        row = ball_in_cup.LEARNERS[job.study.removeprefix("novice-")]
        settings = preset("ball_in_cup", job.arguments["name"], **job.arguments["changes"])
        assert settings.practice.retests == ball_in_cup.RETESTS
        assert settings.practice.model_copy(update={"mean_every": plain.mean_every}) == plain
        assert ("miss" in row.told) == (settings.task_settings.gain > 0.0)


def a_session(caught: int, used: int, confirmed: bool, first: float | None = 0.2) -> dict[str, Any]:
    retests = [{"kind": "retest", "caught": k < caught} for k in range(30)]
    first_one = {"kind": "reproduction", "distance": first, "caught": False}
    return {"used": used, "confirmed": confirmed, "trials": [first_one, *retests]}


def test_the_statistics_of_a_row_count_sessions_and_not_rollouts() -> None:
    found = ball_in_cup.line(
        [
            a_session(30, 18, True, first=0.04),
            a_session(27, 28, True),
            a_session(26, 38, True, first=None),
            a_session(0, 75, False),
        ]
    )
    assert (found["sessions"], found["near"], found["solved"]) == (4, 1, 2)
    assert found["confirmed"] == 3 and found["rollouts"] == [33.0, 18.0, 75.0]
