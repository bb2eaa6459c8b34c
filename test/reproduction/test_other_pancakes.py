# SPDX-License-Identifier: Apache-2.0
"""The study of other pancakes: every way begins with every size."""

import pytest

from reproduction.studies import new_goals, other_pancakes


def test_every_size_is_begun_in_every_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(other_pancakes, "BUDGET", 2)
    monkeypatch.setattr(other_pancakes, "RETESTS", 1)
    result = other_pancakes.session(1, (0.08,))
    found = other_pancakes.rows([result, result])
    keys = {f"{way}, 0.08" for way in other_pancakes.WAYS}
    assert set(result) == {"origin"} | keys
    assert set(found) == set(result) | set(other_pancakes.WAYS)
    for way in other_pancakes.WAYS:
        assert found[way] == found[f"{way}, 0.08"]
        assert new_goals.line(found[way], 1)["sessions"] == 2
        assert all(each["used"] == 2 for each in found[way])
    carried, afresh = found["carried over"][0], found["taught afresh"][0]
    assert carried != afresh
