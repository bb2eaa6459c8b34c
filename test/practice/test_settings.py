# SPDX-License-Identifier: Apache-2.0
"""Settings of a session: what is refused is named with key, value and rule, in one line."""

from __future__ import annotations

import pytest

from wam_power_ros.practice.settings import PracticeSettings, preset


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"learner": {"name": "pwoer"}}, "learner 'pwoer' is not one of .*power"),
        ({"learner": {"sigma": -1}}, "learner_settings.sigma.* = -1: .* greater than or equal"),
        ({"budget": 0}, "practice.budget = 0: .* greater than or equal to 1"),
        ({"budget": 10**9}, "practice.budget = 1000000000: .* less than or equal to 100000"),
        ({"nonsense": 3, "retests": "x"}, "task_settings.nonsense = 3: Extra .*not permitted"),
        ({"return_noise": float("nan")}, "practice.return_noise = nan: .*finite"),
    ],
)
def test_a_setting_that_is_refused_is_named_in_one_line(changes: dict, why: str) -> None:
    with pytest.raises(ValueError, match=rf"invalid settings of task 'flip': {why}") as refused:
        preset("flip", "hindsight", **changes)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 400


@pytest.mark.parametrize("name", PracticeSettings.model_fields)
def test_every_number_of_the_practice_has_a_lower_and_an_upper_bound(name: str) -> None:
    schema = PracticeSettings.model_json_schema()["properties"][name]
    assert {"minimum", "maximum"} <= schema.keys()
