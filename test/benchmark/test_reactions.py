# SPDX-License-Identifier: Apache-2.0
"""The benchmark of reactions in short: arms that are not their model, in one process."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.false_states import OF_JOINT
from benchmark.hidden_arm import KNOWN, begin, draw, held
from benchmark.loop import A_FAULT, acceptable
from wam_power_ros.control.modes import Mode
from wam_power_ros.faults import FaultKind


@pytest.mark.requirement("S-121")
@pytest.mark.parametrize(
    ("name", "phase"),
    [
        *(("swap", phase) for phase in ("upwards", "late", "teaching")),
        *(("sign", phase) for phase in ("upwards", "late")),
    ],
)
def test_states_that_agree_with_each_other_and_are_false_end_in_a_stop(
    name: str, phase: str
) -> None:
    true, loop = held(), held()
    assert begin(true, phase) == begin(loop, phase) == ""
    loop.falsify = OF_JOINT[name](1)
    outcome = loop.observe(3.0)
    assert outcome.fault is not None
    assert acceptable(outcome, true.observe(1.2).peak), outcome


@pytest.mark.requirement("S-44", "S-121")
@pytest.mark.parametrize(("joint", "size"), [(1, 0.2), (1, 1.0), (1, -0.5), (3, 2.0 * np.pi)])
def test_a_jump_of_an_arm_that_nobody_holds_moves_nothing(joint: int, size: float) -> None:
    loop = held()
    loop.controller.set_gravity_compensation(True)
    loop.play(0.1)
    loop.falsify = lambda state: state._replace(q=state.q + size * np.eye(7)[joint])
    outcome = loop.observe(2.0)
    assert outcome.fault is FaultKind.JUMP
    assert outcome.peak < 0.05 and outcome.stop < 0.01


@pytest.mark.requirement("S-122")
@pytest.mark.parametrize("arm", [*KNOWN, 9100, 9101], ids=str)
@pytest.mark.parametrize("phase", ["upwards", "hold"])
def test_an_arm_that_is_not_its_model_stays_where_a_fault_stopped_it(
    arm: str | int, phase: str
) -> None:
    hidden = draw(arm) if isinstance(arm, int) else KNOWN[arm]
    loop = held(hidden)
    begin(loop, phase)  # the fault of an arm that does not get there counts, too
    loop.controller.fault(A_FAULT)
    outcome = loop.observe(4.0)
    assert outcome.rest < 0.05 and outcome.travel < 0.02 and loop.reset(), outcome


@pytest.mark.requirement("S-126")
@pytest.mark.parametrize("arm", ["base tilted 10 degrees", 9100, 9101, 9102], ids=str)
def test_an_arm_that_is_not_its_model_stays_under_gravity_compensation(arm: str | int) -> None:
    loop = held(draw(arm) if isinstance(arm, int) else KNOWN[arm])
    loop.play(1.0)
    loop.controller.set_gravity_compensation(True)
    at = loop.plant.tool_position()
    loop.play(4.0)
    assert loop.controller.mode is Mode.GRAVITY_COMPENSATION
    assert np.linalg.norm(loop.plant.tool_position() - at) < 0.05


@pytest.mark.requirement("S-121")
@pytest.mark.parametrize("seconds", [0.0, 0.004, 0.02, 0.1, 0.3])
def test_a_zero_that_jumps_back_after_the_reset_of_its_fault_moves_nothing(seconds: float) -> None:
    loop = held()
    loop.falsify = OF_JOINT["smooth bump"](1)
    assert loop.observe(3.0).fault is not None
    loop.controller.reset()
    loop.play(seconds)
    loop.falsify = lambda state: state
    outcome = loop.observe(2.0)
    assert outcome.fault is not None
    assert outcome.peak < 0.3, outcome
