# SPDX-License-Identifier: Apache-2.0
"""The study of easy and hard ground: what differs from the novice, and its figures."""

import math

import numpy as np
import pytest

from reproduction.studies import grounds, novice
from reproduction.studies.flip_sessions import stand_in, teach
from wam_power_ros.practice.settings import preset


def test_every_session_is_a_job_of_its_own_and_no_seed_is_one_of_the_other_study() -> None:
    learners = list(grounds.LEARNERS)
    found = grounds.jobs([1, 2], list(grounds.GROUNDS), learners)
    assert len({job.name for job in found}) == len(found) == 2 * 12 * len(learners)
    assert len({str(job.arguments) for job in found}) == len(found)
    assert not set(grounds.HELD_OUT) & set(novice.HELD_OUT)


def test_learners_of_a_ground_differ_in_the_learner_and_what_it_is_told() -> None:
    settings = [
        preset("flip", job.arguments["name"], **job.arguments["changes"])
        for job in grounds.jobs([1], ["novice"], list(grounds.LEARNERS))
    ]
    assert {each.practice for each in settings} == {settings[0].practice}
    assert len({each.learner for each in settings}) == len(settings) - 1  # PoWER twice


@pytest.mark.parametrize(
    ("ground", "tilt", "roll"),
    [
        ("novice", 25.0, 0.0),
        ("level pan", 0.0, 0.0),
        ("10 degrees of tilt", 10.0, 0.0),
        ("rolled by 3 degrees", 25.0, 3.0),
    ],
)
def test_a_demonstration_begins_with_the_pan_as_the_ground_says(
    ground: str, tilt: float, roll: float
) -> None:
    environment = stand_in(1, **grounds.arguments(ground).get("condition", {}))
    (policy,) = teach(environment, 1, 1)
    rotation = environment.arm.tool_pose(policy.q_start)[1]
    assert math.degrees(math.asin(rotation[0, 2])) == pytest.approx(tilt, abs=3.0)
    assert abs(math.degrees(math.asin(rotation[2, 1]))) == pytest.approx(roll, abs=1.0)


@pytest.mark.parametrize("habit", ["late twist", "slow", "tremor"])
def test_a_habit_changes_the_demonstration(habit: str) -> None:
    plain, changed = (teach(stand_in(1), 1, 1, habit=each)[0] for each in ("", habit))
    ratio = changed.basis.duration / plain.basis.duration
    assert (ratio > 1.15) == (habit == "slow")
    assert not np.allclose(changed.rotation_attractors, plain.rotation_attractors, atol=0.02)


def test_a_row_counts_what_was_turned_over_and_a_line_those_that_were_wrong() -> None:
    run = {"true_flip": True, "landed": True}
    short = {**run, "true_flip": False}
    retests = 28 * [run] + 2 * [short]
    session = {"ended_by": "confirmation", "used": 15, "confirmed": 10, "retests": retests}
    short30 = 30 * [short]
    never = {"ended_by": "budget", "used": 60, "retests": short30}
    rows = [grounds.row(session), grounds.row(never), grounds.row({**session, "retests": short30})]
    counted = {"true": 28, "landed": 30, "retests": 30, "rollouts": 15, "confirmed": True}
    assert rows[0] == counted and not rows[1]["confirmed"]
    text = grounds.line(rows)
    assert text.startswith("1 of 3 solved, 3 turned over and caught, 2 confirmed, 1 of them wrong")
    assert text.endswith("median 15, worst decile 60")
