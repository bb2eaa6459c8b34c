# SPDX-License-Identifier: Apache-2.0
"""The conditions of the benchmark of contacts and false alarms."""

from __future__ import annotations

import pytest

from benchmark.contact import CONDITIONS
from hardware_sim.sensors import MocapSettings
from reproduction.studies.flip_sessions import stand_in


@pytest.mark.parametrize("condition", CONDITIONS)
def test_every_condition_is_one_of_the_stand_in(condition: str) -> None:
    world = stand_in(0, **CONDITIONS[condition]).world
    mocap = CONDITIONS[condition].get("mocap")
    assert mocap is None or world._mocap._settings == MocapSettings(**mocap)
