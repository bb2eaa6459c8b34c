# SPDX-License-Identifier: Apache-2.0
"""A simulated person who wants the end of a movement elsewhere."""

from reproduction.studies import rated


def test_ratings_bring_the_end_of_a_movement_near_where_a_person_wants_it() -> None:
    found = [rated.session(seed, "shifts", 0.0) for seed in (1, 2)]
    assert all(run["left"] < rated.NEAR and run["used"] <= rated.ROLLOUTS for run in found)
    assert rated.line(found)["near"] == 2


def test_a_person_who_rates_at_random_does_not() -> None:
    assert rated.line([rated.session(seed, "shifts", 1.0) for seed in (1, 2)])["left"] > rated.NEAR
