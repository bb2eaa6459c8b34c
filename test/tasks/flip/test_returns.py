# SPDX-License-Identifier: Apache-2.0
"""Returns: the values of the paper, the cases it does not define, and the lower bound of zero."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wam_power_ros.tasks.flip.flight import Flight
from wam_power_ros.tasks.flip.returns import landing_return, pancake_return

UP = np.array([0.0, 0.0, 1.0])


def flight(angle: float = math.pi, miss: float = 0.0, **changes: object) -> Flight:
    pan = np.array([0.7, 0.0, 0.9])
    error = np.array([miss, 0.0, 0.12])
    values = {
        "tossed": True,
        "seen": True,
        "t_f": 0.9,
        "position": pan + error,
        "pan_position": pan,
        "normal_start": UP,
        "normal": np.array([math.sin(angle), 0.0, math.cos(angle)]),
        "angle": angle,
        "apex": 0.35,
        "landing_error": error,
        "resting": True,
        "flipped": angle > math.pi / 2.0,
    }
    return Flight(**{**values, **changes})


def total(terms: dict[str, float]) -> float:
    return math.fsum(terms.values())


def test_equation_5_gives_the_papers_returns() -> None:
    # 90 degrees and caught is 0.7, a whole flip and caught 0.9 and more: with 12 cm of level above
    # the pan the position term is 0.44, which leaves the paper's altitudes below 0.2 m.
    quarter = pancake_return(flight(math.pi / 2.0, apex=0.02))
    half = pancake_return(flight(math.pi, apex=0.0))
    assert total(quarter) == pytest.approx(0.7, abs=0.01)
    assert total(half) == pytest.approx(0.94, abs=0.01)
    assert half["orientation"] == pytest.approx(0.5)
    assert half["position"] == pytest.approx(0.5 * math.exp(-0.12))


def test_the_terms_of_equation_5_stand_apart() -> None:
    ret = pancake_return(flight(math.pi / 3.0, miss=0.05))
    assert ret == pytest.approx(
        {"orientation": 0.5 / 3.0, "position": 0.5 * math.exp(-0.13), "altitude": 0.5 * 0.35}
    )


def test_a_dot_product_beyond_one_is_no_error() -> None:
    long = flight(math.pi, normal=np.array([0.0, 0.0, -1.0 - 1e-9]))
    assert pancake_return(long)["orientation"] == pytest.approx(0.5)
    assert pancake_return(replace(long, normal=UP * (1 + 1e-9)))["orientation"] == 0.0


@pytest.mark.parametrize(
    ("changes", "nothing"),
    [
        ({"tossed": False}, {"orientation", "rotation", "landing", "caught"}),
        ({"seen": False}, {"position", "landing"}),
        ({"apex": -0.1}, {"altitude"}),
    ],
)
def test_what_was_not_tossed_not_seen_or_below_its_start_earns_nothing_for_that(
    changes: dict[str, Any], nothing: set[str]
) -> None:
    for return_of in (pancake_return, landing_return):
        terms = return_of(flight(2.0, **changes))
        zero = {name for name, term in terms.items() if term == 0.0}
        assert zero == nothing & terms.keys()


@settings(max_examples=30)
@given(st.floats(0.0, math.pi), st.floats(0.0, 0.5))
def test_landing_return_rises_with_the_turn_and_falls_with_the_miss(
    angle: float, miss: float
) -> None:
    here = total(landing_return(flight(angle, miss)))
    assert total(landing_return(flight(angle * 0.9, miss))) <= here
    assert total(landing_return(flight(angle, miss + 0.1))) <= here
    assert total(landing_return(flight(2.0 * math.pi - angle, miss))) == pytest.approx(here)
