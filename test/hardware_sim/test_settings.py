# SPDX-License-Identifier: Apache-2.0
"""Settings out of range are refused."""

from __future__ import annotations

import math

import pytest

from hardware_sim.settings import (
    ArmSettings,
    SceneSettings,
    WorldSettings,
)


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (WorldSettings, {"command_delay_ticks": -1}),
        (WorldSettings, {"wind_sd": math.nan}),
        (WorldSettings, {"friction_sd": -0.1}),
        (WorldSettings, {"watchdog_damping": math.inf}),
        (WorldSettings, {"payload": -0.1}),
        (WorldSettings, {"torque_constants": (1.0,) * 6}),
        (WorldSettings, {"torque_constants": (*(1.0,) * 6, 0.0)}),
        (SceneSettings, {"friction": -0.1}),
        (SceneSettings, {"body_mass": 0.0}),
        (SceneSettings, {"body_size": math.nan}),
        (SceneSettings, {"body_offset_sd": math.nan}),
        (ArmSettings, {"joints": ("a", "b")}),
        (ArmSettings, {"home": (0.0,) * 6}),
        (ArmSettings, {"guarded": ()}),
    ],
)
def test_settings_out_of_range_are_refused_by_name(kind: type, wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        kind(**wrong)
