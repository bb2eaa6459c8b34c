# SPDX-License-Identifier: Apache-2.0
"""User input during a session: rewards, punishments and further demonstrations."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from toss_task import (
    ANY_ARM,
    CANDIDATES,
    AnyArm,
    demonstrated_policy,
    learner_state,
    next_trial,
    practice_in,
    practice_of,
    toss,
)

from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.power import Power
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.session_log import (
    Line,
    NewDemonstration,
    Rating,
    Record,
    Trial,
    parse_line,
    with_ratings,
)
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.task import Assessment

LATER = demonstrated_policy("flick-9", seed=9)
SETTINGS = preset("flip", "hindsight", budget=40, retests=2, confirm=0, learner={"decay": 0.98})


def started(**changes: object) -> Practice:
    return practice_of(CANDIDATES, preset("flip", "hindsight", **{"confirm": 0, **changes}), 0)


def run(practice: Practice, rollouts: int, judge: Callable[[Trial], Assessment]) -> None:
    for _ in range(rollouts):
        if (trial := practice.next_trial()) is not None:
            practice.learn_assessed(trial, judge(trial))


def worth(ret: float | None, success: bool = False) -> Callable[[Trial], Assessment]:
    flight = {"tossed": True, "seen": False, "angle": 3.0, "landing_error": [0.0, 0.0, 0.0]}
    flight["catch_pitch"] = 0.0
    return lambda trial: Assessment(ret, observation=flight, success=success, why="so it was")


def with_a_person(
    practice: Practice, rollouts: int, keep: Callable[[Line], object] = lambda line: None
) -> None:
    """Continue with a person who gives input between trials and during them."""
    rng = np.random.default_rng(0)

    def perhaps() -> None:
        count = len(practice.records)
        if count and not practice.stopped and rng.random() < 0.4:
            number = int(rng.integers(1, count + 1))
            keep(practice.rate(float(rng.choice([-0.3, 0.3])), number))

    for number in range(rollouts):
        perhaps()
        if (trial := practice.next_trial()) is None:
            return
        perhaps()
        if number in (1, 12):
            name = f"flick-{90 + number}"
            keep(practice.add_demonstration(demonstrated_policy(name, seed=number), f"bags/{name}"))
        keep(practice.learn_assessed(trial, toss(trial, practice.task.settings)))


def test_a_log_with_a_persons_part_goes_on_bit_for_bit_from_every_line() -> None:
    practice = started(budget=40, learner={"decay": 0.98})
    with_a_person(practice, 17)
    log = [parse_line(line.to_json()) for line in practice.log]
    assert {type(line) for line in log} == {Record, Rating, NewDemonstration}
    for cut in range(len(log) + 1):
        again = practice_of(CANDIDATES, practice.settings, 0, log[:cut])
        assert list(again.log) == log[:cut]
        record = next((line for line in log[cut:] if isinstance(line, Record)), None)
        between = log[cut : log.index(record)] if record else []
        if record and all(line.after == record.number for line in between):
            # What comes before the next rollout did not change it: it was drawn already.
            trial = again.next_trial()
            assert (trial.kind, trial.z.tolist()) == (record.kind, record.z)
        for entry in log[cut:]:
            again.apply(entry)
        assert next_trial(again) == next_trial(practice)
        assert again.records == practice.records == with_ratings(log)
        assert learner_state(again.learner) == learner_state(practice.learner)


def test_a_rating_changes_the_elite_from_the_next_trial_on_and_not_the_one_under_way() -> None:
    practice, other = started(), started()
    for each in (practice, other):
        run(each, 8, lambda trial: toss(trial, SETTINGS.task_settings))
    under_way = practice.next_trial()
    worst = min((r for r in practice.records if r.kind == "explore"), key=lambda record: record.ret)
    rating = practice.rate(1.0, worst.number)
    assert rating.after == under_way.number == 9
    assert rating.note == (f"{worst.id} rewarded: return {worst.ret:.3f} -> {worst.ret + 1.0:.3f}")
    assert practice.next_trial() is under_way
    assert other.next_trial().z.tolist() == under_way.z.tolist()
    for each in (practice, other):
        each.learn_assessed(under_way, toss(under_way, each.task.settings))
    assert not np.allclose(practice.learner.mean, other.learner.mean)
    told = Power(practice.learner.size, practice.settings.learner_settings, np.random.default_rng())
    for record in practice.records:
        if record.demonstration == practice.parametrization.policy0.id:
            told.tell(np.array(record.z_corrected), record.ret + (record.number == worst.number))
    np.testing.assert_array_equal(practice.learner.mean, told.mean)


def test_ratings_add_up_and_no_return_falls_below_zero() -> None:
    practice = started()
    run(practice, 5, worth(0.5))
    practice.rate(0.3, 5)
    assert practice.rate(0.3).note == "trial-0005 rewarded: return 0.800 -> 1.100"
    assert practice.records[4].adjustment == pytest.approx(0.6)
    for _ in range(4):
        note = practice.rate(-0.3, 4).note
    assert note == "trial-0004 punished: return 0.000 -> 0.000"
    assert practice.records[3].rated_return == 0.0 and practice.records[3].ret == 0.5


def test_a_punished_rollout_confirms_nothing_and_is_no_evidence_of_success() -> None:
    practice = started(confirm=4)
    run(practice, 6, worth(0.5))
    run(practice, 2, worth(0.9, success=True))
    assert [record.kind for record in practice.records[-2:]] == ["mean", "mean"]
    assert practice.next_trial().purpose == "confirms the mean policy: 2 of 2 succeeded"
    practice.rate(-0.1)
    run(practice, 1, worth(0.9, success=True))
    assert practice.next_trial().kind == "explore"
    assert practice.best.successes == 2 and practice.best.returns == (0.9, 0.8, 0.9)


def test_what_cannot_be_rated_is_refused_with_a_reason() -> None:
    practice = started(budget=4, retests=1)

    def refused(reason: str, amount: float = 0.3, number: int | None = None) -> None:
        before = practice.log
        with pytest.raises(ValueError, match=reason):
            practice.rate(amount, number)
        assert practice.log == before

    refused("no finished rollout to rate yet")
    run(practice, 2, worth(0.5))
    for amount in (math.nan, math.inf, 0.0, 1.5):
        refused("must be within ±1.0 and not 0", amount)
    refused("rollout 3 is not one of the 2 on record", 0.3, 3)
    run(practice, 1, worth(None))
    refused("trial-0003 has no return and is not learnt from: so it was")
    run(practice, 4, worth(0.5))
    refused("the session has stopped learning: budget of 4 rollouts used")
    with pytest.raises(ValueError, match="has stopped learning"):
        practice.add_demonstration(LATER)


def test_a_better_demonstration_is_learnt_from_anew_with_what_is_left_of_the_budget() -> None:
    practice = started(budget=12, retests=1)
    run(practice, 6, worth(0.5))
    drawn = practice.next_trial()
    given = practice.add_demonstration(LATER, "bags/9")
    assert given.note == "flick-9 is reproduced after rollout 7: bags/9"
    assert practice.next_trial() is drawn and practice.candidates[-1].id == "flick-9"
    run(practice, 1, worth(0.5))
    trial = practice.next_trial()
    assert (trial.kind, trial.demonstration, trial.z.any()) == ("reproduction", "flick-9", False)
    run(practice, 1, worth(0.6))
    why = "return 0.600 against 0.500 of the last 5, from flick-1"
    assert practice.choice == practice.records[-1].note == f"learns from flick-9: {why}"
    assert len(practice.learner._rollouts) == 1 and practice.parametrization.policy0.id == "flick-9"
    assert practice.best.policy.id == "trial-0008"
    run(practice, 9, worth(0.7))
    assert {record.demonstration for record in practice.records[8:]} == {"flick-9"}
    assert practice.used == 12 and practice.finished


def test_demonstrations_that_do_not_fit_are_refused_with_a_reason() -> None:
    def infeasible(policy: Policy) -> str:
        return "joint 4 at 9.00 rad/s" if policy.id == "fast" else ""

    practice = practice_of(CANDIDATES, SETTINGS, 0, arm=AnyArm(infeasible))
    for policy, reason in (
        (demonstrated_policy("flick-2"), "there is a demonstration 'flick-2' already"),
        (demonstrated_policy("fast"), "fast is infeasible: joint 4 at 9.00 rad/s"),
    ):
        with pytest.raises(ValueError, match=reason):
            practice.add_demonstration(policy)
    assert practice.log == () and len(practice.candidates) == 2
    practice.add_demonstration(LATER)
    with pytest.raises(ValueError, match="'flick-9' already"):
        practice.add_demonstration(LATER)


def test_lines_of_a_person_are_kept_with_a_session_and_damaged_ones_named(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    with Session.begin(folder, SETTINGS, 0, CANDIDATES) as session:
        practice = session.practice(ANY_ARM)
        with_a_person(practice, 20, session.append)
    found, added = read(folder), ["flick-91", "flick-102"]
    assert tuple(found.log) == practice.log and found.records == practice.records
    assert [policy.id for policy in found.policies] == ["flick-1", "flick-2", *added]
    lines = (folder / "rollouts.jsonl").read_bytes().splitlines(keepends=True)
    kinds = [json.loads(text)["schema"].split("/")[1] for text in lines]
    for kind, change, reason in (
        ("rating", {"amount": "much"}, "amount = 'much': "),
        ("rating", {"after": 99}, "a line that takes effect after rollout 99 cannot follow"),
        ("rating", {"rollout": 99}, "rollout 99 is rated before it is recorded"),
        ("demonstration", {"id": "other"}, "holds policy 'flick-91', expected 'other'"),
        ("demonstration", {"policy": {}}, "policy"),
    ):
        place = kinds.index(kind)
        damaged = json.dumps({**json.loads(lines[place]), **change}).encode() + b"\n"
        text = b"".join([*lines[:place], damaged, *lines[place + 1 :]])
        (folder / "rollouts.jsonl").write_bytes(text)
        with pytest.raises(ValueError, match=reason):
            practice_in(folder)
