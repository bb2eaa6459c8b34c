# SPDX-License-Identifier: Apache-2.0
"""Guarded regions."""

import math

import numpy as np
import pytest

from wam_power_ros.regions import Region, region_of


def test_a_region_contains_what_is_nearer_than_its_radius() -> None:
    region = region_of("box", [0.5, 0.0, 0.25, 0.125])
    assert region == Region("box", (0.5, 0.0, 0.25), 0.125)
    assert region.contains(np.array([0.5, 0.0, 0.37])) and not region.contains(np.zeros(3))
    assert not region.contains(np.array([0.5, 0.0, 0.375]))
    assert region_of("box", [0.5, 0.0, 0.25, 0.0]) is None


def test_a_region_without_name_or_extent_is_refused() -> None:
    for name, place in (
        ("", (0.0, 0.0, 0.0, 0.1)),
        ("box", (0.0, 0.0, 0.0, -0.1)),
        ("box", (0.0, 0.0, 0.1)),
        ("box", (math.nan, 0.0, 0.0, 0.1)),
        ("box", (0.0, 0.0, 0.0, math.inf)),
    ):
        with pytest.raises(ValueError, match="region"):
            Region(name, place[:-1], place[-1])
