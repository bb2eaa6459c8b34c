# SPDX-License-Identifier: Apache-2.0
"""Settings out of range are refused."""

from __future__ import annotations

import math

import pytest

from hardware_sim.settings import WorldSettings


@pytest.mark.parametrize(
    "wrong",
    [
        {"wind_sd": math.nan},
        {"period": 0.0015},
        {"guarded_region": (0.5, 0.0, 0.5, -0.1)},
        {"drives": "wam", "model_joint_names": ("a", "b")},
        {"home": (0.0,) * 6},
        {"home": (0.0,) * 7, "model_joint_names": ("a", "b"), "drives": "direct"},
        {"guarded_points": (0.0, 0.0, 0.0)},
    ],
)
def test_settings_out_of_range_are_refused_by_name(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        WorldSettings(**wrong)
