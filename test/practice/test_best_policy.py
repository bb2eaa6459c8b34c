# SPDX-License-Identifier: Apache-2.0
"""The best policy is chosen by its runs without exploration, and by how many there are."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from toss_task import demonstrated_policy, record_of

from wam_power_ros.practice.best_policy import (
    Best,
    best_without_fault,
    choose_best,
    ended_by_fault,
    overruns,
)
from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import preset

PARAMETERS = preset("flip").make_task({}).parametrization(demonstrated_policy("flick-1"))
PLACES = [np.full(PARAMETERS.size, place).tolist() for place in (0.0, 0.25, 0.5)]
DRAWN = st.fixed_dictionaries(
    {
        "kind": st.sampled_from(["reproduction", "explore", "mean", "retest"]),
        "demonstration": st.sampled_from(["one", "two"]),
        "ret": st.sampled_from([None, 0.0, 0.25, 0.5]),
        "fault": st.sampled_from(["", "", "elbow too fast"]),
        "z": st.sampled_from(PLACES),
        "success": st.booleans(),
    }
)


def record(number: int, **changes: Any) -> Record:  # noqa: ANN401
    return record_of(number, **{"z": PLACES[1], **changes})


def best(records: list[Record], answer: np.ndarray | None = None) -> Best | None:
    return choose_best(records, {"one": PARAMETERS}, "one", answer, "it has ended", 0.2)


def several(*runs: tuple[list[float], list[float]]) -> list[Record]:
    """Records of the means at some coordinates, with their returns."""
    each = [(z, ret) for z, returns in runs for ret in returns]
    return [record(number, z=z, ret=ret) for number, (z, ret) in enumerate(each, start=1)]


def test_more_runs_count_more_than_one_that_was_lucky_and_the_later_policy_wins_a_tie() -> None:
    often = best(several((PLACES[0], [0.68]), (PLACES[1], [0.6] * 4)))
    assert often.policy.id == "trial-0002" and often.returns == (0.6,) * 4 and often.successes == 4
    assert best(several((PLACES[0], [0.98]), (PLACES[1], [0.6] * 4))).policy.id == "trial-0001"
    assert best(several((PLACES[0], [0.6]), (PLACES[1], [0.6]))).policy.id == "trial-0002"


def test_explorations_other_demonstrations_and_refused_policies_are_never_the_best() -> None:
    others = [
        record(1, kind="explore", ret=1.0),
        record(2, demonstration="two", ret=1.0),
        record(3, ret=None, success=False),
    ]
    assert best(others) is None
    refused = record(4, kind="explore", z=PLACES[2], ret=0.0, fault="stopped", refused=True)
    tried = [*others, record(4, z=PLACES[2], ret=0.9), record(5, ret=0.3)]
    assert best(tried).policy.id == "trial-0004"
    assert best([*tried, refused]).policy.id == "trial-0005"
    assert best([*tried[:-1], refused]) is None


def test_the_answer_of_a_session_that_has_ended_is_its_best_whatever_it_attained() -> None:
    records = several((PLACES[0], [0.9, 0.9]), (PLACES[1], [0.1]))
    found = best(records, np.array(PLACES[1]))
    assert found.policy.id == "trial-0003" and "the final policy: it has ended" in found.why


@given(drawn=st.lists(DRAWN, min_size=1, max_size=12))
def test_the_best_without_a_fault_is_of_no_policy_that_a_fault_has_ended(
    drawn: list[dict[str, Any]],
) -> None:
    records = [record(number, **values) for number, values in enumerate(drawn, start=1)]
    judged = [r for r in records if r.ret is not None]
    assert overruns(records) == len([r for r in judged if r.fault])
    for name in ("one", "two"):
        own = [r for r in judged if r.demonstration == name]
        ended = ended_by_fault(records, name)
        for z in PLACES:
            faults = [r for r in own if r.z == z and r.fault and r.kind != "retest"]
            assert (z in ended) == bool(faults)
        found = best_without_fault(records, name)
        ran = [r for r in own if not r.fault and r.z not in ended]
        assert (found is None) == (not ran)
        if found is not None:
            assert found.demonstration == name and not found.fault and found.z not in ended
            assert all(r.ret < found.ret or r.number >= found.number for r in ran)
            assert all(r.ret <= found.ret for r in ran)


def test_what_a_person_ended_is_no_overrun_and_not_run_again() -> None:
    for kind in ("mean", "retest"):
        refused = record(2, kind=kind, ret=0.0, fault="stopped by a person", refused=True)
        records = [record(1, ret=0.4), refused]
        assert overruns(records) == 0 and ended_by_fault(records, "one") == [refused.z]
        assert best_without_fault(records, "one") is None
