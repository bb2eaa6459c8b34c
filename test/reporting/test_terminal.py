# SPDX-License-Identifier: Apache-2.0
"""A running session is shown whatever its task is."""

import io
from dataclasses import replace

import pytest
from rich.console import Console
from toss_task import demonstrated_policy, practice_of, toss

from wam_power_ros.practice.failure import Cause, Failure
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.reporting import terminal


@pytest.fixture
def practice() -> Practice:
    """A session of the flip after six rollouts."""
    settings = preset("flip", "hindsight", budget=6, confirm=0, retests=0)
    practice = practice_of([demonstrated_policy()], settings, seed=0)
    while (trial := practice.next_trial()) is not None:
        practice.learn_assessed(trial, toss(trial, practice.task.settings))
    return practice


@pytest.mark.parametrize("width", [80, 100, 160])
def test_no_head_and_no_outcome_is_cut_at_any_width(practice: Practice, width: int) -> None:
    text, terms = io.StringIO(), dict.fromkeys(("rotation", "altitude", "landing", "caught"), 0.25)
    records = [record.model_copy(update={"terms": terms}) for record in practice.records]
    table = terminal.rollout_table(records, lambda record: "a pancake on the floor", width=width)
    Console(file=text, width=width).print(table)
    assert "…" not in text.getvalue()
    head, *rows = text.getvalue().splitlines()
    assert {"#", "kind", "return", "best", "outcome"} <= set(head.split())
    signs = [rows.pop().strip()] if width == 80 else []
    assert signs == ["no room for landing, caught"] * (width == 80)
    assert len(rows) == len(practice.records)
    for record, row in zip(practice.records, rows, strict=True):
        assert "a pancake on the floor" in row and f"{record.ret:.3f}" in row
    assert ("caught" in head.split()) == (width > 80)  # terms are left out where there is no room
    assert {row.split()[1] for row in rows} == {"reproduction", "exploration", "mean"}  # in full


def test_the_best_return_is_measured_even_if_another_rollout_was_rewarded(
    practice: Practice,
) -> None:
    first = practice.records[0]
    rewarded = first.model_copy(update={"number": 2, "ret": first.ret / 2.0, "adjustment": 1.0})
    table = terminal.rollout_table([first, rewarded], lambda record: "")
    assert [*table.columns[-2].cells] == [f"{first.ret:.3f}"] * 2
    assert f"best {first.ret:.3f} in rollout 1" in terminal.summary(
        [first, rewarded], practice.task
    )


@pytest.mark.parametrize("cause", Cause)
def test_every_cause_of_a_failure_is_one_sentence_with_its_numbers(cause: Cause) -> None:
    (text,) = terminal.failed(Failure(cause, 41, 60, "landing_x", 0.08))
    assert text.startswith("why it failed: ") and ". " not in text and "landing_x" not in text
    assert "60 rollouts" in text or "landing x" in text or "8%" in text
    assert terminal.failed(None) == []


def test_the_summary_begins_with_what_the_demonstration_was_worth_before_learning() -> None:
    settings = preset("flip", "hindsight", budget=8, confirm=0, retests=0)
    candidates = [demonstrated_policy("one"), demonstrated_policy("other")]
    practice = practice_of(candidates, settings, seed=1)
    while (trial := practice.next_trial()) is not None:
        assessment = toss(trial, practice.task.settings)
        worth = 0.2 if trial.demonstration == "one" else 0.3  # the other one is learnt from
        ret = worth if trial.kind == "reproduction" else 0.9
        practice.learn_assessed(trial, replace(assessment, ret=ret, success=ret == 0.9))
    last = practice.records[-1]
    tests = [last.model_copy(update={"kind": "retest", "ret": ret}) for ret in (0.8, 0.9)]
    tests.append(tests[0].model_copy(update={"ret": None, "success": False}))
    text = terminal.summary([*practice.records, *tests], practice.task)
    assert "before learning: return 0.300, no success" in text
    assert "the reproduction of other; after it: mean return 0.850, 2 of 3 re-tests" in text
    assert "before learning" not in terminal.summary(practice.records[:2], practice.task)


def test_the_policy_of_a_session_is_explained_beside_a_higher_return(practice: Practice) -> None:
    first, second, third = practice.records[:3]
    runs = [first.model_copy(update={"number": n, "kind": "retest", "ret": 0.4}) for n in (4, 5)]
    lucky = second.model_copy(update={"kind": "explore", "ret": 0.9})
    other = third.model_copy(update={"kind": "mean", "ret": 0.8})
    first = first.model_copy(update={"ret": 0.1, "success": False})
    runs[1] = runs[1].model_copy(update={"success": True})
    (line,) = terminal.choice([first, lucky, other, *runs], first.id)
    said = "mean return 0.300, 1 of 3 runs without exploration succeeded; only such runs decide"
    assert f"that of {first.id}: {said}" in line
    assert line.endswith("the highest return, 0.900 in rollout 2, was of an exploration")
    (line,) = terminal.choice([first, other, *runs], first.id)
    assert line.endswith("0.800 in rollout 3, was of one run of another policy")
    assert terminal.choice([first, *runs], first.id)[0].endswith("only such runs decide")
    assert terminal.choice([lucky], lucky.id) == []


def test_a_file_gets_every_line_once(practice: Practice) -> None:
    text = io.StringIO()
    console = Console(file=text, width=80)
    with terminal.Display(console) as display:
        log = []  # of a live session, which grows
        for entry in practice.log:
            log.append(entry)
            display.show(log, practice.settings, practice.task)
    how, *lines = text.getvalue().splitlines()
    errors = "rotation, landing x, landing y, catch pitch"
    assert how == f"Task flip, learner power: learns from the return, corrected by {errors}"
    assert [int(line.split()[0]) for line in lines] == [1, 2, 3, 4, 5, 6]


def test_rollouts_of_the_budget_and_re_tests_are_counted_apart(practice: Practice) -> None:
    tests = [
        r.model_copy(update={"kind": "retest"}) if r.number > 4 else r for r in practice.records
    ]
    settings = preset("flip", "hindsight", budget=4, retests=10)
    text = io.StringIO()
    with terminal.Display(Console(file=text, width=120, force_terminal=True)) as display:
        display.show(tests[:3], settings, practice.task)
        display.show(tests, settings, practice.task)
    assert "re-test 2 of 10" in text.getvalue() and "of 14" not in text.getvalue()


def test_a_summary_counts_who_put_the_body_back(practice: Practice) -> None:
    assert terminal.resets(practice.records) == []  # the stand-in did
    by = ["none", "arm", "arm", "arm", "person", "none"]
    records = [
        record.model_copy(update={"clock": {"reset": {"by": who, "seconds": 10.0 * number}}})
        for number, (record, who) in enumerate(zip(practice.records, by, strict=True))
    ]
    (line,) = terminal.resets(records)
    assert line == (
        "put back before 6 rollouts: by nobody in 2 (median 25 s), by the arm in 3 (median 20 s), "
        "by a person in 1 (median 40 s)"
    )
    assert line in terminal.summary(records, practice.task)


def test_trouble_is_printed_and_stays(practice: Practice) -> None:
    text = io.StringIO()
    with terminal.Display(Console(file=text, width=80)) as display:
        display.show_message("torque_controller: mode hold", is_problem=False)
        display.show_message("torque_controller: fault (jump): joint 3", is_problem=True)
    assert text.getvalue() == "torque_controller: fault (jump): joint 3\n"
