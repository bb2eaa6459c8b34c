# SPDX-License-Identifier: Apache-2.0
"""Hindsight correction of a toss: gains and limits of each parameter."""

import math

import numpy as np
import pytest
from conftest import lift

from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.landing_correction import landing_correction
from wam_power_ros.tasks.flip.parametrization import flip_parametrization
from wam_power_ros.tasks.task import Assessment

SETTINGS = preset("flip").task_settings
PLANAR = flip_parametrization(lift("lift"), "planar", SETTINGS.noise)
GAINS = ("landing_gain", "level_gain", "turn_gain", "vigour_gain", "tempo_gain")


def shifts(
    angle: float,
    error: float = 0.0,
    tossed: bool = True,
    seen: bool = True,
    aside: float = 0.0,
    pitch: float = 0.0,
) -> dict[str, float]:
    """Corrections in the units of their parameters; one shift for each parameter."""
    landing = {"landing_error": [error, aside, 9.0], "catch_pitch": pitch}
    flight = {"tossed": tossed, "seen": seen, "angle": angle, **landing}
    found = landing_correction(Assessment(0.5, observation=flight), PLANAR, SETTINGS)
    groups = ("catch_shift", "side_shift", "catch_pitch", "flick", "vigour", "tempo")
    names = {PLANAR.groups[name].start: name for name in groups}
    corrected = {}
    for shift in found:
        (at,) = np.flatnonzero(shift)
        corrected[names[at]] = shift[at] * PLANAR.scale[at]
    assert len(corrected) == len(found)
    return corrected


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_catch_goes_to_where_the_pancake_came_down_up_to_a_limit(sign: float) -> None:
    assert shifts(math.pi, sign * 0.1) == pytest.approx({"catch_shift": sign * 0.7 * 0.1})
    assert shifts(math.pi, sign * 0.9) == pytest.approx({"catch_shift": sign * 0.25})
    aside = shifts(math.pi, aside=sign * 0.1)
    assert aside == pytest.approx({"side_shift": sign * 0.7 * 0.1})


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_pan_that_catches_is_levelled_up_to_a_limit(sign: float) -> None:
    assert shifts(math.pi, pitch=sign * 0.1) == pytest.approx({"catch_pitch": sign * 0.7 * 0.1})
    assert shifts(math.pi, pitch=sign * 0.9) == pytest.approx({"catch_pitch": sign * 0.2})


def test_a_pan_that_is_still_in_its_flick_is_not_levelled() -> None:
    assert "catch_pitch" not in shifts(math.radians(140.0), pitch=0.3)
    assert "catch_pitch" in shifts(math.radians(160.0), pitch=0.3)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_missing_turn_is_added_and_one_too_many_taken_away_up_to_a_limit(sign: float) -> None:
    few = {"flick": 0.5 * 0.06 / 2.0, "vigour": 0.3 * 0.06 / 3.0, "tempo": 0.3 * 0.06 / 6.0}
    most = {"flick": 0.1, "vigour": 0.3, "tempo": 0.15}
    for missing, expected in ((0.06, few), (9.0, most)):
        wanted = {name: sign * value for name, value in expected.items()}
        assert shifts(math.pi - sign * missing) == pytest.approx(wanted)


def test_a_pancake_that_was_not_thrown_misses_all_of_the_turn_and_one_not_seen_tells_nothing() -> (
    None
):
    assert shifts(0.0, tossed=False, seen=False) == shifts(0.0) != {}
    assert shifts(0.0, 0.1, seen=False) == {}
    assert landing_correction(Assessment(0.5), PLANAR, SETTINGS) == []


@pytest.mark.parametrize("kept", GAINS)
def test_only_what_has_a_gain_is_corrected(kept: str) -> None:
    off = dict.fromkeys(set(GAINS) - {kept}, 0.0)
    landing = {"landing_error": [0.1, 0.0, 0.0], "catch_pitch": 0.1}
    flight = {"tossed": True, "seen": True, "angle": 2.7, **landing}
    settings = SETTINGS.model_copy(update=off)
    (shift,) = landing_correction(Assessment(0.5, observation=flight), PLANAR, settings)
    assert np.count_nonzero(shift) == 1
