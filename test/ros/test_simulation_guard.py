# SPDX-License-Identifier: Apache-2.0
"""The guard of a simulated controller names the clocks that do not fit."""

from types import SimpleNamespace

import pytest

from wam_power_ros.ros.guards import SimulationGuard


@pytest.mark.parametrize(
    ("published", "lockstep", "use_sim_time", "advice"),
    [
        (1, False, False, "set use_sim_time: true for all nodes"),
        (0, True, True, "set pace: lockstep for the stand-in"),
        (1, True, True, ""),
        (0, False, False, ""),
        (0, True, False, ""),  # state_timeout: 0 asks for no clock
    ],
)
def test_a_clock_that_is_not_that_of_the_stand_in_is_named(
    published: int, lockstep: bool, use_sim_time: bool, advice: str
) -> None:
    node = SimpleNamespace(
        resolve_topic_name=lambda name: f"/left{name}",
        count_publishers=lambda name: published if name == "/left/clock" else 0,
        get_parameter=lambda name: SimpleNamespace(value=use_sim_time),
    )
    text = SimulationGuard(node, "/joint_states", True, lockstep).other_clock()
    assert advice in text and bool(text) == bool(advice)
    assert ("/left/clock" in text) == bool(advice)
