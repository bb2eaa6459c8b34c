# SPDX-License-Identifier: Apache-2.0
"""The stopping rule counts the successes in a row of one mean."""

import pytest

from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.practice.stopping_rule import StoppingRule


def rollout(success: bool, z: float = 0.0, kind: str = "mean", note: str = "") -> Record:
    return Record(
        number=1,
        id="trial-0001",
        kind=kind,
        demonstration="demonstration-1",
        attempt=1,
        z=[z, 1.0],
        theta=[z, 1.0],
        learnt=True,
        learnt_as=[z, 1.0],
        ret=0.5,
        terms={},
        success=success,
        why="",
        note=note,
        observation=None,
        fault="",
        generator={},
        bag="",
        truth=None,
        clock={},
    )


def rule(confirm: int = 3, mean_every: int = 4) -> StoppingRule:
    settings = PracticeSettings(budget=50, mean_every=mean_every, confirm=confirm, retests=1)
    return StoppingRule(settings, lambda record: record.note != "barely")


def test_exactly_the_required_number_of_successes_in_a_row_completes_it() -> None:
    stopping = rule(confirm=3)
    for count in (1, 2, 3):
        assert not stopping.complete
        assert stopping.add(rollout(True)) == f"{count} of 3 successes in a row"
        assert stopping.z.tolist() == [0.0, 1.0]
    assert stopping.complete


def test_a_success_of_another_mean_begins_a_new_row() -> None:
    stopping = rule(confirm=2)
    stopping.add(rollout(True, z=0.1))
    assert stopping.add(rollout(True, z=0.2)) == "1 of 2 successes in a row"
    assert not stopping.complete and stopping.z.tolist() == [0.2, 1.0]
    stopping.add(rollout(True, z=0.2))
    assert stopping.complete


@pytest.mark.parametrize("failed", [rollout(False), rollout(True, note="barely")])
def test_a_failure_or_a_success_that_does_not_count_ends_the_row(failed: Record) -> None:
    stopping = rule(confirm=3)
    assert stopping.add(failed) == ""
    stopping.add(rollout(True))
    stopping.add(rollout(True))
    assert stopping.add(failed) == "ended after 2 successes in a row"
    assert (stopping.z, stopping.count) == (None, 0)
    assert stopping.add(rollout(True)) == "1 of 3 successes in a row"


def test_explorations_neither_count_nor_end_a_row_and_call_for_the_mean_if_it_is_not_regular() -> (
    None
):
    for mean_every in (0, 4):
        stopping = rule(confirm=3, mean_every=mean_every)
        stopping.add(rollout(True))
        stopping.add(rollout(False, kind="explore"))
        assert stopping.count == 1 and not stopping.mean_is_due
        stopping.add(rollout(True, kind="explore"))
        assert stopping.count == 1 and stopping.mean_is_due is (mean_every == 0)
        stopping.add(rollout(True))
        assert stopping.count == 2 and not stopping.mean_is_due


def test_a_rule_of_no_successes_is_never_complete() -> None:
    stopping = rule(confirm=0, mean_every=0)
    for record in (rollout(True), rollout(True, kind="explore"), rollout(False)):
        assert stopping.add(record) == ""
        assert not stopping.complete and stopping.z is None and not stopping.mean_is_due


@pytest.mark.parametrize(
    ("record", "left"),
    [
        (rollout(True), 0),
        (rollout(True, z=0.3), 2),  # of another mean
        (rollout(True, kind="explore"), 2),
    ],
)
def test_a_row_is_forgotten_with_a_success_that_was_rated_down(record: Record, left: int) -> None:
    stopping = rule()
    stopping.forget(record)  # no row yet
    stopping.add(rollout(True))
    stopping.add(rollout(True))
    stopping.forget(record)
    assert stopping.count == left and (stopping.z is None) is (left == 0)
