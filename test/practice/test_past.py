# SPDX-License-Identifier: Apache-2.0
"""Summaries of past rollouts are what all rollouts together say, after each of them."""

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from wam_power_ros.practice.past import Past
from wam_power_ros.practice.session_log import Record

DRAWN = st.fixed_dictionaries(
    {
        "kind": st.sampled_from(["reproduction", "explore", "mean", "retest"]),
        "demonstration": st.sampled_from(["one", "two"]),
        "ret": st.sampled_from([None, 0.0, 0.25, 0.5]),
        "fault": st.sampled_from(["", "", "elbow too fast"]),
        "z": st.sampled_from([0.0, 1.0, 2.0]),
        "success": st.booleans(),
    }
)


def record(number: int, drawn: dict[str, Any]) -> Record:
    z, learnt = [drawn["z"]], drawn["ret"] is not None
    rest = {"attempt": 1, "terms": {}, "why": "", "note": "", "observation": None, "bag": ""}
    rest |= {"generator": {}, "truth": None, "clock": {}, "learnt": learnt}
    values = drawn | rest | {"z": z, "theta": z, "learnt_as": z if learnt else None}
    return Record(number=number, id=f"trial-{number:04d}", **values)


def check(past: Past, records: list[Record]) -> None:
    assert past.records == records
    assert past.overruns == sum(bool(r.fault) and r.ret is not None for r in records)
    for name in ("one", "two"):
        own = [r for r in records if r.demonstration == name and r.rated_return is not None]
        ended = [r.z for r in own if r.fault and r.kind != "retest"]
        ran = [r for r in own if not r.fault and r.z not in ended]
        assert all(past.ended_in_fault(name, [z]) == ([z] in ended) for z in (0.0, 1.0, 2.0))
        best = max(ran, key=lambda r: r.rated_return or 0.0) if ran else None
        assert past.best_without_fault(name) == best
        without = [r for r in own if r.kind != "explore"]
        runs = past.runs_without_exploration(name)
        first: dict[float, str] = {}
        for r in without:
            first.setdefault(r.z[0], r.id)
        assert [r.id for r in runs] == list(first.values())
        for found in runs:
            same = [r for r in without if r.z == found.z.tolist()]
            assert found.returns == [r.rated_return for r in same]
            assert found.mean == float(np.mean(found.returns))
            assert found.successes == sum(r.succeeded for r in same)
    both = past.runs_without_exploration(None)
    assert len(both) == sum(len(past.runs_without_exploration(name)) for name in ("one", "two"))


@given(drawn=st.lists(DRAWN, min_size=1, max_size=12), data=st.data())
def test_each_rollout_and_rating_keeps_the_summaries_up_to_date(
    drawn: list[dict[str, Any]], data: st.DataObject
) -> None:
    past, records = Past(), []
    for number, values in enumerate(drawn, start=1):
        records.append(record(number, values))
        past.add(records[-1])
        check(past, records)
    number = data.draw(st.integers(1, len(records)))
    amount = data.draw(st.sampled_from([-0.5, -0.25, 0.25, 0.5]))
    records[number - 1] = records[number - 1].with_rating(amount)
    check(past.rated(number, amount), records)
