# SPDX-License-Identifier: Apache-2.0
"""The benchmark of reactions in short: arms that are not their model, in one process."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.false_states import FALSE_STATES, OF_JOINT
from benchmark.hidden_arm import KNOWN, begin, held
from benchmark.loop import A_FAULT, Outcome, acceptable
from benchmark.reaction_matrix import drawn
from wam_power_ros.control.modes import Mode
from wam_power_ros.faults import FaultKind


@pytest.mark.requirement("S-121")
@pytest.mark.parametrize(("name", "phase"), [("swap", "teaching"), ("sign", "late")])
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
@pytest.mark.parametrize(("joint", "size"), [(1, -0.5), (3, 2.0 * np.pi)])
def test_a_jump_of_an_arm_that_nobody_holds_moves_nothing(joint: int, size: float) -> None:
    loop = held()
    loop.controller.set_gravity_compensation(True)
    loop.play(0.1)
    loop.falsify = lambda state: state._replace(q=state.q + size * np.eye(7)[joint])
    outcome = loop.observe(2.0)
    assert outcome.fault is FaultKind.JUMP
    assert outcome.peak < 0.05 and outcome.stop < 0.01


@pytest.mark.requirement("S-122")
@pytest.mark.parametrize(
    ("arm", "phase"), [("payload of 0.5 kg", "hold"), (9100, "upwards")], ids=str
)
def test_an_arm_that_is_not_its_model_stays_where_a_fault_stopped_it(
    arm: str | int, phase: str
) -> None:
    hidden = drawn(arm) if isinstance(arm, int) else KNOWN[arm]
    loop = held(hidden)
    begin(loop, phase)  # the fault of an arm that does not get there counts, too
    loop.controller.fault(A_FAULT)
    outcome = loop.observe(4.0)
    assert outcome.rest < 0.05 and outcome.travel < 0.02 and loop.reset(), outcome


@pytest.mark.requirement("S-126")
def test_an_arm_that_is_not_its_model_stays_under_gravity_compensation() -> None:
    loop = held(KNOWN["base tilted 10 degrees"])
    loop.play(1.0)
    loop.controller.set_gravity_compensation(True)
    at = loop.plant.tool_position()
    loop.play(4.0)
    assert loop.controller.mode is Mode.GRAVITY_COMPENSATION
    assert np.linalg.norm(loop.plant.tool_position() - at) < 0.05


@pytest.mark.requirement("S-121")
def test_a_zero_that_jumps_back_after_the_reset_of_its_fault_moves_nothing() -> None:
    loop = held()
    loop.falsify = OF_JOINT["smooth bump"](1)
    assert loop.observe(3.0).fault is not None
    loop.controller.reset()
    loop.play(0.3)
    loop.falsify = lambda state: state
    outcome = loop.observe(2.0)
    assert outcome.fault is not None
    assert outcome.peak < 0.3, outcome


def guided(name: str, rng: np.random.Generator, let_go: bool) -> tuple[Outcome, float, bool]:
    """False states while the arm is guided, or moves after it; the speed after them; resettable."""
    loop = held()
    core = loop.controller
    core.set_gravity_compensation(True)
    loop.plant.guide(int(rng.integers(100)))
    loop.play(rng.uniform(0.2, 1.2))
    if let_go:
        loop.plant.let_go()
        core.set_gravity_compensation(False)
        loop.play(1.0)
        core.move_to_start()
        loop.play(rng.uniform(0.05, 0.4))
    loop.falsify = FALSE_STATES[name]()
    outcome = loop.observe(3.2)
    loop.plant.let_go()
    loop.falsify = lambda state: state
    loop.play(3.0)
    return outcome, max(loop.speeds[1:]), loop.reset()


@pytest.mark.requirement("S-121")
@pytest.mark.parametrize(
    ("name", "seed"), [("silence", 7000), ("the same state again and again", 7003)]
)
def test_an_arm_whose_driver_falls_silent_while_a_person_guides_it_comes_to_rest(
    name: str, seed: int
) -> None:
    outcome, after, reset = guided(name, np.random.default_rng(seed), let_go=False)
    assert outcome.noticed and outcome.rest < 0.1
    assert after < 0.1 and reset


@pytest.mark.requirement("S-121")
def test_an_arm_whose_joint_seems_not_to_move_is_braked_by_its_model() -> None:
    outcome, _, reset = guided("joint 2 frozen", np.random.default_rng([8, 5]), let_go=True)
    assert outcome.noticed and outcome.rest < 0.1
    assert reset
