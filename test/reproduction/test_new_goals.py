# SPDX-License-Identifier: Apache-2.0
"""The study of new goals: every way begins with the same goals, and its statistics."""

import numpy as np
import pytest

from reproduction.studies import new_goals


def test_every_goal_is_begun_in_every_way_and_a_prediction_needs_fewer_rollouts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(new_goals, "GOALS", new_goals.GOALS[:2])
    result = new_goals.session(1)
    found = {way: new_goals.line(result[way]) for way in new_goals.WAYS}
    assert {each["sessions"] for each in found.values()} == {2}
    assert found["predicted"]["confirmed"] == 2
    assert found["predicted"]["rollouts"] < found["taught afresh"]["rollouts"]


def test_a_session_without_a_success_counts_as_one_that_never_succeeded() -> None:
    one = {"first": 3, "used": 9, "confirmed": 4, "successes": 20}
    never = {"first": None, "used": 60, "confirmed": 0, "successes": 0}
    found = new_goals.line([one, never, None])
    assert (found["sessions"], found["begun"]) == (3, 2)
    assert found["first success"] == [3.0, 3.0, np.inf]
    assert (found["confirmed"], found["robust"], found["first rollout succeeds"]) == (1, 1, 0)
